"""Columns of a CSV file by name, and its times as integer nanoseconds."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import regular
from polar_nav_ros.adapters.section import Section

from .sources import Stamps

TIME_UNITS = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1, 'iso': 0}
_LAST_S = 2**31 - 1
_DELIMITERS = {'comma': ',', 'semicolon': ';', 'tab': '\t'}


@dataclass(frozen=True)
class CsvFile:
    """One file: where it is and the names in its first line."""

    path: Path
    delimiter: str
    names: tuple[str, ...]
    skip: int

    def column(self, section: Section, key: str, name: str, dtype: Any = float) -> NDArray[Any]:  # noqa: ANN401
        """Read one column; an empty cell is NaN.

        Raises
        ------
        ConfigError
            When there is no such column, or a cell is no number.
        """
        if name not in self.names:
            raise section.fail(
                key, f'{self.path} has no column {name!r}; it has {", ".join(self.names)}'
            )
        options: dict[str, Any] = {
            'delimiter': self.delimiter,
            'usecols': self.names.index(name),
            'encoding': 'utf-8',
            'comments': None,
        }
        try:
            try:
                found = np.loadtxt(self.path, dtype=dtype, skiprows=self.skip, ndmin=1, **options)
            except ValueError:
                if dtype is not float:
                    raise
                found = self._with_gaps(options)
        except ValueError as error:
            raise section.fail(key, f'{self.path}: column {name!r}: {error}') from error
        if not len(found):
            raise section.fail(key, f'{self.path} has no line below its first')
        return np.asarray(found)

    def _with_gaps(self, options: dict[str, Any]) -> Array:
        """Read a column in which cells are empty."""
        cells = np.loadtxt(
            self.path, dtype=str, skiprows=self.skip, ndmin=1, **{**options, 'quotechar': '"'}
        )
        return np.array([float(c) if c.strip() else np.nan for c in cells])


def open_file(section: Section, folder: Path) -> CsvFile:
    """Open the ``file`` of a section, relative to the folder of the YAML file."""
    path = folder / section.text('file')
    delimiter = _DELIMITERS[section.choice('delimiter', tuple(_DELIMITERS), 'comma')]
    try:
        with regular(path).open(encoding='utf-8-sig', newline='') as stream:
            first = next(csv.reader(stream, delimiter=delimiter), [])
    except ConfigError as error:
        raise section.fail('file', str(error)) from error
    except (OSError, csv.Error) as error:
        why = getattr(error, 'strerror', None) or error
        raise section.fail('file', f'{path}: {why}') from error
    except UnicodeDecodeError as error:
        raise section.fail('file', f'{path} is not UTF-8: {error}') from error
    names = tuple(name.strip() for name in first)
    if len(set(names)) != len(names) or not any(names):
        raise section.fail('file', f'{path}: the first line must name the columns, each once')
    return CsvFile(path, delimiter, names, 1)


def times(section: Section, file: CsvFile, key: str = 'time') -> Stamps:
    """Times of a column as nanoseconds since 1970, by ``time_unit`` and ``time_origin_s``.

    Numbers are read with more digits than float64 has, where the machine can: epoch seconds keep
    their nanoseconds.
    """
    name = section.text(key)
    unit = section.choice('time_unit', tuple(TIME_UNITS), 's')
    origin_s = section.number('time_origin_s', 0.0, -4e9, 4e9, 's')
    if unit == 'iso':
        cells = file.column(section, key, name, str)
        try:
            found = np.array([c.strip().rstrip('Z') for c in cells], dtype='datetime64[ns]')
        except ValueError as error:
            raise section.fail(key, f'{file.path}: column {name!r}: {error}') from error
        stamps = found.astype(np.int64)
    elif unit == 'ns':
        stamps = file.column(section, key, name, np.int64)
    else:
        value = file.column(section, key, name, np.longdouble)
        if not np.isfinite(value).all():
            raise section.fail(key, f'{file.path}: column {name!r} is not a time in every line')
        value *= TIME_UNITS[unit]
        _check_range(section, file, key, name, value + round(origin_s * 1e9))
        stamps = np.round(value).astype(np.int64)
    _check_range(section, file, key, name, stamps.astype(float) + origin_s * 1e9)
    return np.asarray(stamps + round(origin_s * 1e9), dtype=np.int64)


def _check_range(
    section: Section, file: CsvFile, key: str, name: str, times_ns: NDArray[Any]
) -> None:
    """Refuse times that no stamp can hold; a message counts seconds in 32 bits."""
    bad = np.flatnonzero(~((times_ns >= 0.0) & (times_ns < _LAST_S * 1e9)))
    if bad.size:
        raise section.fail(
            key,
            f'{file.path}: column {name!r}: {float(times_ns[bad[0]]) * 1e-9:g} s in line '
            f'{bad[0] + file.skip + 1} is no time between 1970 and 2038; see time_unit and '
            'time_origin_s',
        )


def vectors(section: Section, file: CsvFile, key: str, count: int = 3) -> Array:
    """Read as many columns as ``key`` must name, as rows. -> (n, count).

    A minus before a name turns the sign of that column: an axis that points the other way.
    """
    names = section.raw(key)
    if not isinstance(names, list) or len(names) != count:
        raise section.fail(key, f'{names!r} is not a list of {count} columns')
    return np.column_stack(
        [_signed(section, file, f'{key}[{i}]', str(n)) for i, n in enumerate(names)]
    )


def _signed(section: Section, file: CsvFile, key: str, name: str) -> Array:
    if name.startswith('-') and name not in file.names:
        return -file.column(section, key, name[1:])
    return file.column(section, key, name)


def optional(section: Section, file: CsvFile, key: str) -> Array | None:
    """Read a column that need not be there; a minus before its name turns its sign."""
    if key not in section:
        section.raw(key)
        return None
    return _signed(section, file, key, section.text(key))


def same_length(section: Section, columns: Sequence[NDArray[Any] | None]) -> None:
    """Insist on columns of equal length."""
    lengths = {len(c) for c in columns if c is not None}
    if len(lengths) > 1:
        raise ConfigError(f'{section.place}: columns of different length: {sorted(lengths)}')
