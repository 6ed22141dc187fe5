"""How kernels are compiled that only kernels call: to be linked, not to be run by themselves.

numba optimises each function that it compiles and makes machine code of it, and does both again
with the copy of it in each function that calls it. Of a kernel that Python never calls the first
is thrown away. Such a kernel ends here as LLVM's intermediate code, as it was lowered: the `entry`
that links it optimises all of it together, as it would in any case.

A large one that several entries call would be optimised with each of them. It is compiled apart:
once, as machine code that those call by name, and that is loaded before they are.

This stands on parts of numba that are not documented. :func:`missing` names those that another
numba may lack: kernels are then compiled in numba's own way, slower and to the same numbers.
"""

from __future__ import annotations

import weakref
from importlib import import_module
from typing import Any, NamedTuple

import llvmlite.binding as llvm
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary, JITCPUCodegen
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
    CPUCodeLibrary: ('_get_module_for_linking', '_ensure_finalized'),
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


class Apart(JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """A function's code as machine code; who links it gets nothing, and calls it by its name."""

    _shared_module: Any

    def _get_module_for_linking(self) -> Any:  # noqa: ANN401 - numba's
        self._ensure_finalized()
        if self._shared_module is None:
            empty = str(self._codegen._create_empty_module(self.name))
            self._shared_module = llvm.parse_assembly(empty)
        return self._shared_module


class ApartCompiler(Compiler):  # type: ignore[misc]  # numba has no types
    """numba's compiler, into an `Apart`."""

    def define_pipelines(self) -> Any:  # noqa: ANN401 - numba's
        """Return numba's own steps; the code goes where it says here.

        Numba numbers functions in the order in which a process compiles them, and the number is in
        the name. Here it is the same for all processes: one calls what another has compiled.
        """
        self.state.func_id.unique_id = 0  # numba's own begin at 1
        name = self.state.func_id.func_qualname
        self.state.library = Apart(self.state.targetctx.codegen(), name)
        self.state.library.enable_object_caching()
        return super().define_pipelines()


class Needed(NamedTuple):
    """A kernel compiled apart, which is loaded before any that calls it: numba calls this then."""

    module: str
    name: str
    arguments: tuple[Any, ...]

    def __call__(self) -> None:
        """Load it, or compile it where it is not in the cache."""
        getattr(import_module(self.module), self.name).compile(self.arguments)


COMPILER = Compiler if missing() else InnerCompiler
"""Compiler of kernels that only kernels call."""
APART = Compiler if missing() else ApartCompiler
"""Compiler of those that are compiled apart."""
