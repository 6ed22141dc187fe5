"""Fields of one message by their paths; messages need them as attributes only."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

_STEP = re.compile(r'\.?(\w+)|\[(\d+)\]')


def get(message: Any, path: str) -> Any:  # noqa: ANN401 - whatever a message holds
    """Field of a message by its path, as ``twist.linear.x`` or ``beams[0].range``."""
    value = message
    for name, index in _STEP.findall(path):
        value = getattr(value, name) if name else value[int(index)]
    return value


def stamp_ns_of(message: Any, paths: tuple[str, ...], arrival_ns: int) -> int:  # noqa: ANN401
    """Stamp that a message has [ns]: seconds and nanoseconds, or one field; arrival of none.

    Raises
    ------
    ValueError
        When the field is not a time.
    """
    if not paths:
        return arrival_ns
    values = [get(message, path) for path in paths]
    if len(values) == 2:
        return int(values[0]) * 1_000_000_000 + int(values[1])
    return ns_of(values[0], paths[0])


def ns_of(value: Any, path: str) -> int:  # noqa: ANN401 - of any message
    """Nanoseconds of a Time, of seconds as a float or of whole nanoseconds; errors as above."""
    if hasattr(value, 'nanosec'):
        return int(value.sec) * 1_000_000_000 + int(value.nanosec)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f'field {path} is not a time')
        return round(value * 1e9)
    return int(value)


class Fields:
    """Paths of a message, as a collection: whether one is there, and the outermost names."""

    def __init__(self, sample: object) -> None:
        self._sample = sample

    def __contains__(self, path: object) -> bool:
        """Tell whether the message has a field of that path."""
        try:
            get(self._sample, str(path))
        except IndexError:  # of a list that is empty in this message
            return True
        except (AttributeError, TypeError):
            return False
        return True

    def __iter__(self) -> Iterator[str]:
        """Names of the outermost fields."""
        fields = getattr(self._sample, 'get_fields_and_field_types', None)
        names = fields() if fields is not None else vars(self._sample)
        return iter([str(name) for name in names])

    def __len__(self) -> int:
        """Return the number of outermost fields."""
        return len(list(iter(self)))
