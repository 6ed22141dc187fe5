"""Filters of station mode compared in the tables, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from polar_nav_core.errors import ConfigError

_NEVER = 10_000
"""Number of fixes above that of any run."""
_ONCE: dict[str, Any] = {'identify_nis_fixes': _NEVER, 'identify_every': _NEVER}
"""Identify when the window is full, and never again: the paper's figures show one adaptation."""


@dataclass(frozen=True)
class StationColumn:
    """One filter, a column of the tables.

    Attributes
    ----------
    name, doc : str
        Name of the column; description, one line.
    changes : dict
        Parameters of the engine.
    uncompensated : bool
        Whether filter and identification treat every fix as valid at its arrival.
    """

    name: str
    doc: str
    changes: dict[str, Any] = field(default_factory=dict)
    uncompensated: bool = False


def _published(method: str = 'published', **changes: Any) -> dict[str, Any]:  # noqa: ANN401 - of the engine
    return {
        'station_filter': 'published',
        'station_validity': 'travel_time',
        'station_adaptation': 'always',
        'identify_method': method,
        **_ONCE,
        **changes,
    }


def _single(walk: float, method: str = 'none', **changes: Any) -> dict[str, Any]:  # noqa: ANN401 - of the engine
    return {
        'station_filter': 'augmented',
        'current_method': 'single',
        'current_walk': walk,
        'station_adaptation': 'always',
        'identify_method': method,
        **_ONCE,
        **changes,
    }


COLUMNS: dict[str, StationColumn] = {
    c.name: c
    for c in (
        StationColumn(
            'published',
            'the paper: Eqs. 8-13 with FIFO, Levenberg-Marquardt once at 300 fixes',
            _published(),
        ),
        StationColumn(
            'published_uncompensated',
            'the same with every fix treated as of its arrival, by filter and identification',
            _published(station_validity='packet'),
            uncompensated=True,
        ),
        StationColumn(
            'published_shifted',
            'published, and each correction also shifts the states in the FIFO',
            _published(published_fifo='shifted'),
        ),
        StationColumn(
            'published_again',
            'published, adapted again every 100 fixes',
            _published(identify_every=100),
        ),
        StationColumn(
            'published_robust',
            "the paper's filter with the robust identification, once at 300 fixes",
            _published('robust'),
        ),
        StationColumn(
            'augmented_1e-6',
            'current, drag and heading bias as states, q_c 1e-6 m²/s³',
            _single(1e-6),
        ),
        StationColumn('augmented_1e-5', 'the same, q_c 1e-5 m²/s³', _single(1e-5)),
        StationColumn(
            'augmented_restarted',
            'augmented_1e-6, restarted from the robust identification at 300 fixes',
            _single(1e-6, 'robust'),
        ),
        StationColumn(
            'augmented_ignoring',
            'augmented_1e-6, every fix treated as of its arrival',
            _single(1e-6),
            uncompensated=True,
        ),
        StationColumn('default', "the follower's default: a bank of four q_c, exact delay"),
    )
}


def pick(names: Sequence[str]) -> list[StationColumn]:
    """Columns by name, in this order.

    Raises
    ------
    ConfigError
        For an unknown name.
    """
    for name in names:
        if name not in COLUMNS:
            raise ConfigError(f'--columns: no filter {name!r}; there are {", ".join(COLUMNS)}')
    return [COLUMNS[name] for name in names]
