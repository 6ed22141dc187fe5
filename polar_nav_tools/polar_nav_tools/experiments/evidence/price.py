"""The price of reserve in a perfect world, and honesty where everything stated is drawn.

*perfect*: no mismatch; the default with its reserve (walks of the biases), its gate and its
weights against the exact filter with the true model. Sensor classes are stated as they are, the
sigmas of common errors as zero. *drawn*: each constant, slow and common error is drawn from the
sigma that the default states (drawn.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE, EngineParams

from ...scoring.tables import Column, Table
from ..experiment import Experiment
from ..jobs import RunResult
from ..mismatch.plan import as_stated
from ..mismatch.row import FIX
from ..mismatch.scenes import SinsScene
from ..request import Size
from ..world_spec import WorldSpec
from .case import Case
from .drawn import Drawn, world_of
from .late import CLASSES
from .plan import experiment_of, of
from .pooled import NEES_COLUMNS, nees_cells, nees_note, ratio_cells, rms, spread_of_ratio, values

GOAL = 1.15
_USUAL = EngineParams()
EXACT: dict[str, Any] = {
    'configuration': 'custom',
    'delay_handling': 'rewind',
    'noise_adaptation': 'none',
    'gate_probability': 1.0,
    'max_fix_sigma': 0.0,
    **NO_RESERVE,
    **NO_COMMON_ERRORS,
}
RESERVED: dict[str, Any] = {
    'configuration': 'default',
    **NO_COMMON_ERRORS,
    **{name: getattr(_USUAL, name) for name in NO_RESERVE},
}
MISSIONS = ('', 'racetrack', 'lawnmower', 'dive', 'over_pole', 'south_pole')
"""Missions of both worlds; the first is the straight run."""


def cases(duration_s: float) -> list[Case]:
    """Return the perfect worlds and the drawn ones."""
    rates: dict[str, Any] = {'dvl_rate_hz': 5.0, 'depth_rate_hz': 5.0}
    worlds = {
        f'perfect_{name or "straight"}': WorldSpec(
            duration_s=duration_s, mission=name, constants='prior', **rates
        )
        for name in MISSIONS
    }
    worlds['perfect_no_dvl'] = WorldSpec(
        duration_s=duration_s, constants='prior', **{**rates, 'dvl_rate_hz': 0.0}
    )
    for name, spec in CLASSES.items():
        worlds[f'perfect_{name}'] = WorldSpec(
            duration_s=duration_s, constants='prior', imu_vices=False, **rates, **spec
        )
    perfect = [
        Case(
            name,
            SinsScene(world, FIX),
            {'default': RESERVED, 'exact': EXACT},
            watched=False,
            fixed=('exact',),
        )
        for name, world in worlds.items()
    ]
    stated = {'configuration': 'default', **as_stated('sins')}
    drawn = [
        Case(
            f'drawn_{name or "straight"}{"" if formation else "_leader_stays"}',
            SinsScene(world_of(duration_s, mission=name), FIX),
            {'default': stated},
            watched=False,
            shape=Drawn(formation=formation),
        )
        for name in MISSIONS
        for formation in (True, False)
        if formation or name in ('', 'racetrack')
    ]
    return [*perfect, *drawn]


def tables(chosen: Sequence[Case], results: Sequence[RunResult], size: Size) -> list[Table]:
    """Return the table of the price and that of honesty."""
    note = nees_note(size.seeds)
    perfect = [_price(c, results) for c in chosen if 'exact' in c.columns]
    drawn = [_honesty(c, results) for c in chosen if 'exact' not in c.columns]
    out = []
    if perfect:
        met = sum(bool(row.get('met')) for row in perfect)
        columns = (
            Column('case', 'world'),
            Column('rms', 'default', 'm'),
            Column('reference', 'exact', 'm'),
            Column('ratio', 'ratio', digits=4),
            Column('spread', 'of single seeds'),
            *NEES_COLUMNS,
            Column('exact_nees', 'NEES position of exact'),
            Column('met', f'at most {GOAL}'),
        )
        text = f'{met} of {len(perfect)} rows at most {GOAL}. Horizontal RMS, second half. {note}'
        out.append(Table('Price of reserve in a perfect world', columns, tuple(perfect), text))
    if drawn:
        columns = (
            Column('case', 'world'),
            Column('rms', 'RMS', 'm'),
            Column('said', 'said', 'm'),
            *NEES_COLUMNS,
            Column('met', 'inside'),
        )
        met = sum(bool(row['met']) for row in drawn)
        text = f'{met} of {len(drawn)} rows inside. Horizontal RMS and sigma, second half. {note}'
        out.append(Table('Honesty where all that is stated is drawn', columns, tuple(drawn), text))
    return out


def _price(case: Case, results: Sequence[RunResult]) -> dict[str, object]:
    runs, exact = of(results, case, 'default'), of(results, case, 'exact')
    return {
        'case': case.name,
        'rms': rms(runs),
        'reference': rms(exact),
        'spread': spread_of_ratio(runs, exact),
        **nees_cells(runs),
        'exact_nees': nees_cells(exact).get('nees_position'),
        **ratio_cells(runs, exact, GOAL),
    }


def _honesty(case: Case, results: Sequence[RunResult]) -> dict[str, object]:
    runs = of(results, case, 'default')
    cells = nees_cells(runs)
    said = values(runs, 'said')
    return {
        'case': case.name,
        'rms': rms(runs),
        'said': float((said**2).mean() ** 0.5) if len(said) else None,
        **cells,
        'met': bool(cells) and not any('*' in str(c) for c in cells.values()),
    }


PRICE: Experiment = experiment_of(
    'price',
    'The price of reserve in a perfect world; NEES where all that is stated is drawn',
    (Size(1200.0, 20), Size(200.0, 1)),
    cases,
    tables,
)
