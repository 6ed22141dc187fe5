"""Offline commands where rclpy has no build: messages are read and written in Python.

    python tests/without_rclpy.py verify BAG --certificate FILE

The message classes have to be there, without their libraries. docs/operation.md uses it to run
on an emulated arm64.
"""

from __future__ import annotations

import struct
import sys
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

from rosidl_parser import definition as idl

HEADER = b'\x00\x01\x00\x00'
"""Little-endian CDR."""
LENGTH = idl.BasicType('uint32')
FORMATS = {
    'boolean': '<?', 'octet': '<c', 'uint8': '<B', 'int8': '<b', 'int16': '<h', 'uint16': '<H',
    'int32': '<i', 'uint32': '<I', 'int64': '<q', 'uint64': '<Q', 'float': '<f', 'double': '<d',
}  # fmt: skip


class Named(type):
    def __getattr__(cls, name):
        if name.startswith('__'):
            raise AttributeError(name)
        return cls()


class Anything(metaclass=Named):
    """What modules name, call or inherit from of rclpy while they are imported."""

    def __init__(self, *_args, **_settings): ...


class Rclpy(MetaPathFinder, Loader):
    """Modules of rclpy: names without a meaning, but for those of `serialization`."""

    def find_spec(self, name, _path, _target=None):
        mine = name.partition('.')[0] == 'rclpy'
        return ModuleSpec(name, self, is_package=True) if mine else None

    def create_module(self, spec):
        return ModuleType(spec.name)

    def exec_module(self, module):
        if module.__name__ == 'rclpy.serialization':
            module.serialize_message, module.deserialize_message = serialize, deserialize
        else:
            module.__getattr__ = lambda name: type(name, (Anything,), {})


def serialize(message) -> bytes:
    out = bytearray()
    _write_fields(out, message)
    return HEADER + bytes(out)


def deserialize(data, kind):
    assert bytes(data[:4]) == HEADER
    return _read_fields(memoryview(data)[4:], 0, kind())[0]


def _fields(message):
    return zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True)


def _write_fields(out, message):
    for name, kind in _fields(message):
        _write(out, kind, getattr(message, name))


def _write(out, kind, value):
    if isinstance(kind, idl.BasicType):
        form = FORMATS[kind.typename]
        out += bytes(-len(out) % struct.calcsize(form)) + struct.pack(form, value)
    elif isinstance(kind, idl.AbstractString):
        text = value.encode() + b'\0'
        _write(out, LENGTH, len(text))
        out += text
    elif isinstance(kind, idl.AbstractNestedType):
        if not isinstance(kind, idl.Array):
            _write(out, LENGTH, len(value))
        for item in value:
            _write(out, kind.value_type, item)
    else:
        _write_fields(out, value)


def _read_fields(data, at, message):
    for name, kind in _fields(message):
        value, at = _read(data, at, kind)
        setattr(message, name, value)
    return message, at


def _read(data, at, kind):
    if isinstance(kind, idl.BasicType):
        form = FORMATS[kind.typename]
        at += -at % struct.calcsize(form)
        return struct.unpack_from(form, data, at)[0], at + struct.calcsize(form)
    if isinstance(kind, idl.AbstractString):
        size, at = _read(data, at, LENGTH)
        return bytes(data[at : at + size - 1]).decode(), at + size
    if isinstance(kind, idl.AbstractNestedType):
        size, at = (kind.size, at) if isinstance(kind, idl.Array) else _read(data, at, LENGTH)
        items = []
        for _ in range(size):
            item, at = _read(data, at, kind.value_type)
            items.append(item)
        return items, at
    return _read_fields(data, at, getattr(import_module('.'.join(kind.namespaces)), kind.name)())


if __name__ == '__main__':
    sys.meta_path.insert(0, Rclpy())
    sys.exit(import_module('polar_nav_tools.cli').main())
