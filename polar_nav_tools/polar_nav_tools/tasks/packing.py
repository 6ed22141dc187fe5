"""Results as bytes: dataclasses of numbers, texts and arrays, back bit for bit.

MessagePack with the types of the dataclass on the way back, never pickle: a file of rows that came
from somewhere else can state wrong numbers, not run code.
"""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec
import numpy as np

R = TypeVar('R')


def pack(result: object) -> bytes:
    """Bytes of a result."""
    return msgspec.msgpack.encode(result, enc_hook=_plain)


def unpack(kind: type[R], data: bytes) -> R:
    """Result of a kind from its bytes.

    Raises
    ------
    ValueError
        For bytes of another kind.
    """
    try:
        return msgspec.msgpack.decode(data, type=kind, dec_hook=_array)
    except msgspec.MsgspecError as error:
        raise ValueError(f'no {kind.__name__}: {error}') from error


def _plain(value: Any) -> Any:  # noqa: ANN401 - what msgspec does not know
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f'{type(value).__name__} cannot be packed')


def _array(kind: Any, value: Any) -> Any:  # noqa: ANN401 - the one other kind: an array
    del kind
    dtype, shape, data = value
    found = np.dtype(dtype)
    if found.hasobject:
        raise ValueError('an array of objects')
    return np.frombuffer(data, found).reshape(shape).copy()
