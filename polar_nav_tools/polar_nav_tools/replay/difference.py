"""First message and field at which a live run and its replay differ."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from rclpy.serialization import deserialize_message

from polar_nav_ros.stamps import to_ns

from .life import TYPES


@dataclass(frozen=True)
class Difference:
    """First message at which live run and replay differ."""

    topic: str
    index: int
    stamp_ns: int
    field: str
    live: str
    replayed: str

    def __str__(self) -> str:
        at = f'{self.topic}, message {self.index}, stamp {self.stamp_ns * 1e-9:.6f} s'
        return f'{at}, {self.field}: live {self.live}, replayed {self.replayed}'


def first_difference(topic: str, live: list[bytes], replayed: list[bytes]) -> Difference:
    """First message of a topic at which live run and replay differ, and the field in it."""
    msg_type = TYPES[topic]
    for i, (a, b) in enumerate(zip(live, replayed, strict=False)):
        if a != b:
            left, right = deserialize_message(a, msg_type), deserialize_message(b, msg_type)
            stamp_ns = to_ns(left.header.stamp)
            found = _first_field(left, right, '')
            if found is not None:
                return Difference(topic, i, stamp_ns, *found)
            at = next(k for k, (x, y) in enumerate(zip_longest(a, b)) if x != y)
            return Difference(
                topic, i, stamp_ns, f'byte {at}', a[at:].hex()[:16], b[at:].hex()[:16]
            )
    longer = live if len(live) > len(replayed) else replayed
    i = min(len(live), len(replayed))
    stamp_ns = to_ns(deserialize_message(longer[i], msg_type).header.stamp)
    present, absent = 'a message', 'none'
    values = (present, absent) if longer is live else (absent, present)
    return Difference(topic, i, stamp_ns, 'count', *values)


def _first_field(left: Any, right: Any, name: str) -> tuple[str, str, str] | None:  # noqa: ANN401
    """Name and both values, with all digits, of the first number or text that differs."""
    if hasattr(left, 'get_fields_and_field_types'):
        for part in left.get_fields_and_field_types():
            inner = f'{name}.{part}' if name else part
            found = _first_field(getattr(left, part), getattr(right, part), inner)
            if found is not None:
                return found
        return None
    if not isinstance(left, str) and hasattr(left, '__len__'):
        if len(left) != len(right):
            return f'{name}, length', str(len(left)), str(len(right))
        for i, (x, y) in enumerate(zip(left, right, strict=True)):
            found = _first_field(x, y, f'{name}[{i}]')
            if found is not None:
                return found
        return None
    x, y = (repr(v.item() if hasattr(v, 'item') else v) for v in (left, right))
    return (name, x, y) if x != y else None
