"""Decoder of single messages by the installed class, or one made from the bag's definition."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from importlib import import_module
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from .contents import Channel
from .errors import BagError
from .limits import check_definition
from .schemas import definition

Decode = Callable[[bytes], Any]
Fields = Sequence[tuple[str, tuple[Nodetype, Any]]]


class Decoder:
    """Source of decoding functions for the channels of one bag.

    Parameters
    ----------
    where : str
        The bag, for sentences.
    """

    def __init__(self, where: str) -> None:
        self._where = where

    def for_channel(self, channel: Channel) -> Decode:
        """Return a function from CDR bytes to a message.

        Raises
        ------
        BagError
            If the definition in the bag cannot be used; the function itself raises it for bytes
            that are no such message.
        """
        if channel.encoding != 'cdr':
            raise BagError(
                f'{self._where}: {channel.topic} is encoded as {channel.encoding!r}, not as cdr'
            )
        try:
            store = store_of(channel.schema_text, channel.type)
        except BagError as error:
            raise BagError(f'{self._where}: {channel.topic}: {error}') from error
        decode = _installed(channel) or _embedded(store, channel.type)

        def checked(data: bytes) -> Any:  # noqa: ANN401 - a message of the channel's type
            try:
                return decode(data)
            except Exception as error:  # bytes from a file can fail in any way
                raise BagError(
                    f'{self._where}: a message on {channel.topic} is no {channel.type} '
                    f'({len(data)} bytes: {type(error).__name__} {error})'
                ) from error

        return checked


@lru_cache(maxsize=256)
def store_of(text: str, type_name: str) -> Typestore:
    """Return a rosbags type store with one type and its dependencies, from a ros2msg text.

    Raises
    ------
    BagError
        If the text is no such definition.
    """
    if not text:
        raise BagError(f'there is no definition of {type_name}')
    check_definition(text, type_name)
    try:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(text, type_name))
        _check_closed(store, type_name)
    except BagError:
        raise
    except Exception as error:  # a parser on text from a file
        raise BagError(f'the definition of {type_name} is not understood ({error})') from error
    return store


def fields_of(store: Typestore, type_name: str) -> Fields:
    """Return names and types of a message's fields, in order, in rosbags' notation."""
    return store.fielddefs[type_name][1]


def _check_closed(store: Typestore, type_name: str) -> None:
    """Raise BagError unless every type in use is defined."""
    waiting, seen = [type_name], set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        if name not in store.fielddefs:
            raise BagError(f'the definition of {type_name} lacks {name}')
        for _, (kind, what) in fields_of(store, name):
            inner_kind, inner = (kind, what) if kind <= Nodetype.NAME else what[0]
            if inner_kind == Nodetype.NAME:
                waiting.append(inner)


def is_installed(channel: Channel) -> bool:
    """Whether the type is installed here with the same fields; constants may have other values."""
    return _installed(channel, constants=False) is not None


def constants_of(channel: Channel) -> dict[str, Any]:
    """Return the constants of a channel's type with the values that they have in the bag.

    Raises
    ------
    BagError
        If the definition in the bag cannot be used.
    """
    defined = store_of(channel.schema_text, channel.type).fielddefs[channel.type][0]
    return {name: value for name, _, value in defined}


def _embedded(store: Typestore, type_name: str) -> Decode:
    return lambda data: store.deserialize_cdr(data, type_name)


def _installed(channel: Channel, *, constants: bool = True) -> Decode | None:
    """Decoding function of rclpy if the type is installed with the bag's fields, else None."""
    try:
        own = definition(channel.type)
        if not _same(own.text, channel.schema_text, channel.type, constants=constants):
            return None
        package, _, name = channel.type.split('/')
        message = getattr(import_module(f'{package}.msg'), name)
        deserialize = import_module('rclpy.serialization').deserialize_message
    except (BagError, ImportError, AttributeError):
        return None
    little = struct.pack('<H', 0x0100)

    def decode(data: bytes) -> Any:  # noqa: ANN401 - a message of the channel's type
        # rclpy does not check the encapsulation in the first two bytes.
        if data[:2] != little:
            raise ValueError(f'encapsulation {data[:2].hex()} is not plain CDR')
        return deserialize(data, message)

    return decode


def _same(text: str, other: str, type_name: str, *, constants: bool) -> bool:
    if text == other:
        return True
    mine, theirs = store_of(text, type_name), store_of(other, type_name)
    first = 0 if constants else 1
    return mine.fielddefs.keys() <= theirs.fielddefs.keys() and all(
        mine.fielddefs[k][first:] == theirs.fielddefs[k][first:] for k in mine.fielddefs
    )
