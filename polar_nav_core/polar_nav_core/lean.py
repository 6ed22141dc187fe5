"""Memory of a process whose kernels are compiled: what only the compiler needs is given back.

Beside the machine code of each kernel that it loads, numba holds its intermediate code, with which
it compiles others that call it: more than a hundred megabytes in a follower, which compiles none.
"""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

from numba.core.registry import CPUDispatcher

_KERNELS = f'{__package__}.kernels.'


def drop_intermediate_code() -> int:
    """Return the number of loaded kernels whose intermediate code was freed.

    A kernel that is compiled later, against all expectation, reads that of its callees again from
    the cache. Kernels that this process compiled itself keep theirs.
    """
    dropped = 0
    for dispatcher, signature, library in _loaded():
        if getattr(library, '_shared_module', None) is not None:
            library._get_module_for_linking = partial(_read_again, dispatcher, signature)
            library._shared_module = None
            dropped += 1
    gc.collect()
    _return_free_memory()
    return dropped


def _loaded() -> Iterator[tuple[Any, Any, Any]]:
    """Dispatcher, signature and library of each kernel that came from the cache."""
    modules = [m for name, m in sys.modules.items() if name.startswith(_KERNELS)]
    functions = {id(f): f for module in modules for f in vars(module).values()}
    for dispatcher in functions.values():
        if isinstance(dispatcher, CPUDispatcher):
            for signature in dispatcher.stats.cache_hits:
                yield dispatcher, signature, dispatcher.overloads[signature].library


def _read_again(dispatcher: Any, signature: Any) -> Any:  # noqa: ANN401 - numba's
    """Intermediate code of a kernel, as an LLVM module, from the cache."""
    again = dispatcher._cache.load_overload(signature, dispatcher.targetctx)
    return again.library._get_module_for_linking()


def _return_free_memory() -> None:
    """Have the C library return what it holds for later: arenas do not shrink by themselves."""
    trim = getattr(ctypes.CDLL(None), 'malloc_trim', None)
    if trim is not None:  # glibc
        trim(0)
