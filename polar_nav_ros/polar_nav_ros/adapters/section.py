"""Reads one section of a YAML file key by key, with errors that name file, key and value."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import read_yaml

from . import rotations

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 100
shown = _SHORT.repr
"""A value as a sentence may quote it, cut where it is long or deep."""

TO_FILL = 'is still to be filled in:'
"""What errors say of a mark that `polar map` left."""


class Section:
    """One mapping of a YAML file; `done` refuses keys that nobody asked for.

    Parameters
    ----------
    place : str
        File and section, for sentences.
    values : object
        What stands there.

    Raises
    ------
    ConfigError
        When it is no mapping.
    """

    def __init__(self, place: str, values: object) -> None:
        if not isinstance(values, Mapping):
            raise ConfigError(f'{place}: expected keys with values, found {shown(values)}')
        self.place = place
        self._values = dict(values)
        self._asked: set[str] = set()

    def __contains__(self, key: str) -> bool:
        """Tell whether a key is given."""
        return self._values.get(key) is not None

    def raw(self, key: str) -> Any:  # noqa: ANN401 - whatever stands in YAML
        """Return the value of a key as YAML has it; None when it is not given."""
        self._asked.add(key)
        return self._values.get(key)

    def fail(self, key: str, why: str) -> ConfigError:
        """Return an error on a key."""
        return ConfigError(f'{self.place}: {key}: {why}')

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text; without a default the key is required."""
        value = self.raw(key)
        if value is None:
            if default is None:
                raise self.fail(key, 'is missing')
            return default
        if not isinstance(value, str) or not value:
            raise self.fail(key, f'{shown(value)} is not a text')
        if key == 'topic' and is_to_fill(value):
            raise self.fail(key, f'{TO_FILL} the name of a topic')
        return value

    def choice(self, key: str, options: Sequence[str], default: str | None = None) -> str:
        """Return one of a few words."""
        value = self.text(key, default)
        if value not in options:
            said = TO_FILL if is_to_fill(value) else f'{shown(value)} is none of'
            raise self.fail(key, f'{said} {", ".join(options)}')
        return value

    def number(self, key: str, default: float | None, lo: float, hi: float, unit: str) -> float:
        """Return a number in [lo, hi]; without a default the key is required."""
        value = self.raw(key)
        if value is None:
            if default is None:
                raise self.fail(key, f'is missing [{unit}]')
            return default
        return self._number(key, value, lo, hi, unit)

    def optional(self, key: str, lo: float, hi: float, unit: str) -> float | None:
        """Return a number in [lo, hi], or None when it is not given."""
        value = self.raw(key)
        return None if value is None else self._number(key, value, lo, hi, unit)

    def _number(self, key: str, value: object, lo: float, hi: float, unit: str) -> float:
        if is_to_fill(value):
            raise self.fail(key, f'{TO_FILL} a number [{unit}]')
        if isinstance(value, str):  # YAML takes 1e-3 for a text
            try:
                value = float(value)
            except ValueError:
                raise self.fail(key, f'{shown(value)} is not a number [{unit}]') from None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(key, f'{shown(value)} is not a number [{unit}]')
        if not (math.isfinite(value) and lo <= value <= hi):
            raise self.fail(key, f'{value} is outside of [{lo:g}, {hi:g}] {unit}')
        return float(value)

    def numbers(
        self, key: str, default: Sequence[float] | None, lo: float, hi: float, unit: str
    ) -> tuple[float, float, float]:
        """Return three numbers; without a default the key is required."""
        value = self.raw(key)
        if value is None:
            if default is None:
                raise self.fail(key, f'is missing: a list of 3 numbers [{unit}]')
            value = list(default)
        if not isinstance(value, list) or len(value) != 3:
            raise self.fail(key, f'{shown(value)} is not a list of 3 numbers [{unit}]')
        x, y, z = (self._number(f'{key}[{i}]', v, lo, hi, unit) for i, v in enumerate(value))
        return x, y, z

    def rotation(self, key: str = 'rotation', default: str = 'flu') -> Array:
        """C_s_b, shape (3, 3): a name of axes, ``{rpy_deg: [..]}`` or ``{quaternion: [..]}``."""
        value = self.raw(key)
        if is_to_fill(value):
            raise self.fail(key, f'{TO_FILL} where its axes x, y and z point, as in flu or frd')
        try:
            if value is None:
                return rotations.named(default)
            if isinstance(value, str):
                return rotations.named(value)
            inner = Section(f'{self.place}: {key}', value)
            if 'quaternion' in inner:
                quaternion = inner.raw('quaternion')
                if not isinstance(quaternion, list) or len(quaternion) != 4:
                    raise self.fail(key, f'quaternion {shown(quaternion)} is not [x, y, z, w]')
                C_s_b = rotations.from_quaternion([float(v) for v in quaternion])
            else:
                rpy_deg = inner.numbers('rpy_deg', None, -360.0, 360.0, 'deg')
                C_s_b = rotations.from_rpy_deg(rpy_deg)
            inner.done()
        except (ValueError, TypeError) as error:
            if isinstance(error, ConfigError):
                raise
            raise self.fail(key, str(error)) from error
        return np.asarray(C_s_b)

    def section(self, key: str) -> Section | None:
        """Return a section within this one, or None when it is not given."""
        value = self.raw(key)
        return None if value is None else Section(f'{self.place}: {key}', value)

    def sections(self, key: str) -> list[Section]:
        """Return the entries of a list of sections; one section alone is a list of one."""
        value = self.raw(key)
        if value is None:
            return []
        entries = value if isinstance(value, list) else [value]
        return [Section(f'{self.place}: {key}[{i}]', v) for i, v in enumerate(entries)]

    def texts(self, key: str) -> dict[str, Any]:
        """Return a mapping of names to anything; empty when it is not given."""
        value = self.raw(key)
        if value is None:
            return {}
        if not isinstance(value, Mapping):
            raise self.fail(key, f'expected names with values, found {shown(value)}')
        return {str(k): v for k, v in value.items()}

    def done(self) -> None:
        """Refuse keys that nobody asked for.

        Raises
        ------
        ConfigError
            Naming the first of them and those that are known.
        """
        unknown = sorted(set(self._values) - self._asked, key=str)
        if unknown:
            known = ', '.join(sorted(self._asked))
            comma = POINT if isinstance(unknown[0], int) else ''
            raise ConfigError(
                f'{self.place}: unknown key {unknown[0]}{comma}; known here: {known}'
            )


POINT = ' (numbers have a decimal point, no comma)'
"""Of a key that is a number: 0,5 between braces is a 0 and a key 5."""


def is_to_fill(value: object) -> bool:
    """Return whether a value is one of the marks that `polar map` leaves."""
    return isinstance(value, str) and value.replace('/', '_').strip('_') == 'FILL_IN'


def load(path: Path) -> Section:
    """Read a YAML file.

    Raises
    ------
    ConfigError
        When it is not there, not YAML, or no mapping.
    """
    return Section(str(path), read_yaml(path))
