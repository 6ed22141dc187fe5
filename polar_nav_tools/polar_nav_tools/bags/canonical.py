"""Serialized messages without the bytes that mean nothing: equal messages get equal bytes.

CDR leaves gaps before numbers that need alignment, and the serializer of ROS 2 leaves in them
whatever was in memory: two serializations of one message differ. Here the gaps (and the zero byte
behind each string, and anything behind the last field) become zero. Everything that is a field
stays bit for bit, the sign of a zero and the bits of a NaN included.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from .decode import store_of
from .layout import ENCAPSULATION, Layout, layout_of

_MAX_MASKS = 1024

Mask = NDArray[np.uint8]


def canonical(messages: Iterable[bytes], type_name: str, text: str) -> Iterator[bytes]:
    """Yield the messages with all bytes zero that belong to no field.

    Parameters
    ----------
    messages : iterable of bytes
        CDR with encapsulation, of one type.
    type_name, text : str
        Type and its ros2msg definition.

    Raises
    ------
    BagError
        If one is no message of that type.
    """
    store = store_of(text, type_name)
    # Messages of one layout share their mask; most topics have one or a few layouts.
    known: dict[int, list[tuple[Layout, Mask]]] = {}
    for message in messages:
        candidates = known.setdefault(len(message), [])
        mask = next((m for layout, m in candidates if _has_layout(message, layout)), None)
        if mask is None:
            layout = layout_of(store, type_name, message)
            mask = _mask(layout, len(message))
            if len(candidates) < _MAX_MASKS:
                candidates.append((layout, mask))
        yield (np.frombuffer(message, np.uint8) & mask).tobytes()


def sha256_of(messages: Iterable[bytes], type_name: str, text: str) -> str:
    """Return the SHA-256 of the canonical bytes of messages, each preceded by its length."""
    digest = hashlib.sha256()
    for message in canonical(messages, type_name, text):
        digest.update(len(message).to_bytes(8, 'little'))
        digest.update(message)
    return digest.hexdigest()


def _has_layout(message: bytes, layout: Layout) -> bool:
    order = 'little' if layout.order == '<' else 'big'
    if message[:2] != (b'\0\1' if layout.order == '<' else b'\0\0'):
        return False
    return all(
        int.from_bytes(message[at : at + 4], order) == length  # type: ignore[arg-type]
        for at, length in layout.lengths.items()
    )


def _mask(layout: Layout, size: int) -> Mask:
    mask = np.zeros(size, np.uint8)
    mask[: ENCAPSULATION - 2] = 0xFF  # the two bytes behind are options that nobody sets
    for at in layout.lengths:
        mask[at : at + 4] = 0xFF
    for leaf in layout.leaves.values():
        width = int(leaf.format[1:]) * (1 if leaf.count is None else leaf.count)
        mask[leaf.offset : leaf.offset + width] = 0xFF
    return mask
