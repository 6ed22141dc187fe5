"""Serialized messages whose bytes depend on their content only.

CDR aligns numbers, and the serializer leaves the gaps as the memory happened to be: two equal
messages can differ in bytes that mean nothing. Live and replayed output are compared byte for
byte, so the gaps are set to zero here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

from rclpy.serialization import serialize_message
from rosidl_parser import definition as idl

_HEADER = 4
_SIZES = {
    'boolean': 1, 'octet': 1, 'char': 1, 'uint8': 1, 'int8': 1, 'int16': 2, 'uint16': 2,
    'int32': 4, 'uint32': 4, 'float': 4, 'int64': 8, 'uint64': 8, 'double': 8,
}  # fmt: skip

_Step = Callable[[bytearray, int], int]
"""Zeroes the gaps of one member that begins at a position; the position behind it."""


def to_bytes(message: Any) -> bytes:  # noqa: ANN401 - any ROS message
    """CDR bytes of a message, gaps zero."""
    data = bytearray(serialize_message(message))
    _steps_of(type(message))(data, 0)  # type: ignore[arg-type]  # types do hash
    return bytes(data)


def _align(data: bytearray, position: int, size: int) -> int:
    gap = -position % size
    if gap:
        start = _HEADER + position
        data[start : start + gap] = bytes(gap)
    return position + gap


def _number(size: int, count: int) -> _Step:
    def step(data: bytearray, position: int) -> int:
        return _align(data, position, size) + size * count

    return step


def _length(data: bytearray, position: int) -> int:
    order = 'little' if data[1] == 1 else 'big'
    return int.from_bytes(data[_HEADER + position : _HEADER + position + 4], order)  # type: ignore[arg-type]


def _string(data: bytearray, position: int) -> int:
    position = _align(data, position, 4)
    return position + 4 + _length(data, position)


def _repeated(step: _Step, count: int) -> _Step:
    def steps(data: bytearray, position: int) -> int:
        for _ in range(count):
            position = step(data, position)
        return position

    return steps


def _sequence(element: idl.AbstractType) -> _Step:
    step = _step_of(element)
    size = _SIZES.get(element.typename) if isinstance(element, idl.BasicType) else None

    def steps(data: bytearray, position: int) -> int:
        position = _align(data, position, 4)
        count = _length(data, position)
        position += 4
        if size is not None:  # numbers in a row have no gaps but the first
            return _align(data, position, size) + size * count if count else position
        for _ in range(count):
            position = step(data, position)
        return position

    return steps


def _step_of(kind: idl.AbstractType) -> _Step:
    if isinstance(kind, idl.BasicType):
        return _number(_SIZES[kind.typename], 1)
    if isinstance(kind, idl.AbstractString):
        return _string
    if isinstance(kind, idl.Array):
        if isinstance(kind.value_type, idl.BasicType):
            return _number(_SIZES[kind.value_type.typename], kind.size)
        return _repeated(_step_of(kind.value_type), kind.size)
    if isinstance(kind, idl.AbstractSequence):
        return _sequence(kind.value_type)
    if isinstance(kind, idl.NamespacedType):
        return _steps_of(_class_of(kind))  # type: ignore[arg-type]
    raise TypeError(f'no CDR layout is known for {kind}')


def _class_of(kind: idl.NamespacedType) -> type[Any]:
    found: type[Any] = getattr(import_module('.'.join(kind.namespaces)), kind.name)
    return found


@cache
def _steps_of(message_type: type[Any]) -> _Step:
    steps = tuple(_step_of(kind) for kind in message_type.SLOT_TYPES)

    def all_steps(data: bytearray, position: int) -> int:
        for step in steps:
            position = step(data, position)
        return position

    return all_steps
