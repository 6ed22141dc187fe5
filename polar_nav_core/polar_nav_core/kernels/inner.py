"""How kernels are compiled that only kernels call: to be linked, not to be run by themselves.

numba optimises each function that it compiles and makes machine code of it, and does both again
with the copy of it in each function that calls it. Of a kernel that Python never calls the first
is thrown away. Such a kernel ends here as LLVM's intermediate code, as it was lowered: the `entry`
that links it optimises all of it together, as it would in any case.

This stands on parts of numba that are not documented. :func:`missing` names those that another
numba may lack: kernels are then compiled in numba's own way, slower and to the same numbers.
"""

from __future__ import annotations

import weakref
from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import Compiler

_ENVIRONMENT = '_ZN08NumbaEnv'
"""How the names of numba's environments begin: a pointer that it writes for each function."""
_NEEDED: dict[Any, tuple[str, ...]] = {
    JITCodeLibrary: (
        '_optimize_final_module',
        '_finalize_final_module',
        '_finalize_dynamic_globals',
        '_verify_declare_only_symbols',
        'enable_object_caching',
    ),
    JITCPUCodegen: ('_create_empty_module', '_add_module'),
    Compiler: ('define_pipelines',),
}


def missing() -> list[str]:
    """Return what of numba's inside this needs and does not find: nothing, as a rule."""
    return [
        f'{kind.__name__}.{name}'
        for kind, names in _NEEDED.items()
        for name in names
        if not hasattr(kind, name)
    ]


class LinkedOnly(JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """A function's code for those that link it; as machine code it is empty."""

    def _optimize_final_module(self) -> None:
        """Leave that to whoever links it."""

    def _finalize_final_module(self) -> None:
        """Make machine code of the environments alone: numba looks them up when it loads."""
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        variables = self._final_module.global_variables
        empty = str(self._codegen._create_empty_module(self.name))
        kept = [str(v) for v in variables if v.name.startswith(_ENVIRONMENT)]
        module = llvm.parse_assembly('\n'.join([empty, *kept]))
        # What numba's own method sets, under the name that Python makes of it there: by that the
        # machine code comes back for the cache.
        module._CPUCodeLibrary__library = weakref.proxy(self)
        self._codegen._add_module(module)
        self._codegen._engine.finalize_object()
        self._finalized = True


class InnerCompiler(Compiler):  # type: ignore[misc]  # numba has no types
    """numba's compiler, into a `LinkedOnly`."""

    def define_pipelines(self) -> Any:  # noqa: ANN401 - numba's
        """Return numba's own steps; the code goes where it says here."""
        name = self.state.func_id.func_qualname
        self.state.library = LinkedOnly(self.state.targetctx.codegen(), name)
        self.state.library.enable_object_caching()
        return super().define_pipelines()


COMPILER = Compiler if missing() else InnerCompiler
"""Compiler of kernels that only kernels call."""
