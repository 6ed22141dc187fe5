"""Kernels that are called for every IMU sample, without numba's look at each of their arguments.

In each call numba finds out the types of all arguments, array by array: of a filter's two hundred
arrays that takes several times as long as the work on a sample.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba.core.registry import CPUDispatcher


def machine_code(kernel: Callable[..., Any], *like: Any) -> Callable[..., Any]:  # noqa: ANN401 - as the kernel takes
    """Return the machine code of an `entry` for arguments of the types of these.

    It takes positional arguments of exactly those types, and does not look: who holds it sees to
    that. A kernel that is not compiled is returned as it is.
    """
    if not isinstance(kernel, CPUDispatcher):
        return kernel
    types = tuple(numba.typeof(argument) for argument in like)
    if types not in kernel.overloads:
        kernel.compile(types)
    found: Callable[..., Any] = kernel.overloads[types].entry_point
    return found


class Direct:
    """Machine code of an `entry`, found anew where the arguments that have other types change.

    Parameters
    ----------
    kernel : callable
        An `entry`.
    """

    def __init__(self, kernel: Callable[..., Any]) -> None:
        self._kernel = kernel
        self._code: Callable[..., Any] | None = None
        self._of: tuple[Any, ...] = ()

    def call(self, changing: tuple[Any, ...], *arguments: Any) -> Any:  # noqa: ANN401 - kernel's
        """Return what the kernel returns.

        Parameters
        ----------
        changing : tuple
            Objects that stand for the types of the arguments: while they are the same objects, the
            types are the same.
        arguments
            Of the kernel.
        """
        code = self._code
        if code is None or any(a is not b for a, b in zip(changing, self._of, strict=True)):
            code = self._code = machine_code(self._kernel, *arguments)
            self._of = changing
        return code(*arguments)
