"""All rows of the table, and a selection by name.

Their sentences and sizes stand in rows.yaml.
"""

from __future__ import annotations

from fnmatch import fnmatchcase

from polar_nav_core.errors import ConfigError

from ..draws import numbers_after
from .dvl_rows import DEPTH_ROWS, DVL_ROWS
from .faults import Fault
from .fix_rows import DELAY_ROWS, FIX_ROWS
from .imu_rows import COMPASS_ROWS, HEADING_ROWS, IMU_ROWS
from .random_rows import RANDOM, random_row
from .random_station_rows import RANDOM_STATION, random_station_row
from .row import CONTROL, Row, row, scene_of
from .station_rows import STATION_ROWS

_CONTROLS = (
    *(
        row(f'{CONTROL}_{name}', Fault(), (), scene=scene_of(mission=name, duration_s=duration_s))
        for name, duration_s in (
            ('demo', 600.0),
            ('near_pole', 600.0),
            ('over_pole', 600.0),
            ('south_pole', 600.0),
            ('antimeridian', 600.0),
            ('racetrack', 900.0),
            ('lawnmower', 1200.0),
            ('dive', 600.0),
        )
    ),
    row(f'{CONTROL}_straight', Fault(), ()),
)


ROWS: dict[str, Row] = {
    one.name: one
    for one in (
        *_CONTROLS,
        *IMU_ROWS,
        *DVL_ROWS,
        *DEPTH_ROWS,
        *HEADING_ROWS,
        *COMPASS_ROWS,
        *FIX_ROWS,
        *DELAY_ROWS,
        *STATION_ROWS,
    )
}


MORE = 'more:'
"""Before a pattern: it is for rows of further faults only."""
_DRAWN = {RANDOM: random_row, RANDOM_STATION: random_station_row}


def rows_named(pattern: str | None) -> list[Row]:
    """Rows whose names match a comma-separated list of shell patterns; for None the table's.

    A pattern after `MORE` is for further faults, which no other one finds: they are as many again.
    A whole name finds its row in both. Numbers after `RANDOM` and
    `RANDOM_STATION` are rows drawn at random.

    Raises
    ------
    ConfigError
        If a pattern matches no row, or what follows `RANDOM` or `RANDOM_STATION` is no number.
    """
    if not pattern:
        return [r for r in ROWS.values() if not r.more]
    chosen: dict[str, Row] = {}
    for word in (w.strip() for w in pattern.split(',')):
        drawn = next((prefix for prefix in _DRAWN if word.startswith(prefix)), '')
        if drawn:
            rows = [_DRAWN[drawn](number) for number in numbers_after(drawn, word)]
            chosen |= {r.name: r for r in rows}
            continue
        more = word.startswith(MORE)
        sought = word.removeprefix(MORE)
        found = {n: r for n, r in ROWS.items() if r.more is more and fnmatchcase(n, sought)}
        if not more and word in ROWS:
            found = {word: ROWS[word]}
        if not found:
            raise ConfigError(
                f'--rows: no row matches {word!r}; there are {", ".join(rows_by_table(more=more))}'
            )
        chosen |= found
    return list(chosen.values())


def rows_by_table(*, more: bool) -> list[str]:
    """Names of the rows of the table, or of further faults."""
    return [n for n, r in ROWS.items() if r.more is more]
