"""Late fixes: the default against the same filter in order over what was received by then.

The reference is `rewind` with the gate and the robust weights of the default: it goes back to each
fix and forward again, so that at every time it equals the filter that has all fixes received by
then in order. IMUs have the white noise and the constant biases that are stated, so that nothing
but the delay is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

from polar_nav_core.engine.methods import CONFIGURATIONS

from ...scoring.tables import Column, Table
from ..experiment import Experiment
from ..jobs import RunResult
from ..mismatch.scenes import SinsScene
from ..request import Size
from ..schedule import FixSpec
from ..world_spec import WorldSpec
from .case import Case
from .plan import experiment_of, of
from .pooled import NEES_COLUMNS, nees_cells, nees_note, ratio_cells, rms, spread_of_ratio

GOAL = 1.01
CLASSES: dict[str, dict[str, Any]] = {
    'navigation': {'imu': 'navigation', 'gyro_bias_dph': 0.01, 'accel_bias_g': 100e-6},
    'fog': {
        'imu': 'fog',
        'gyro_bias_dph': 1.0,
        'accel_bias_g': 1e-3,
        'initial_sigma_tilt_deg': 0.1,
        'initial_sigma_heading_deg': 0.5,
    },
    'stim300': {
        'imu': 'stim300',
        'gyro_bias_dph': 5.0,
        'accel_bias_g': 750e-6,
        'initial_sigma_tilt_deg': 0.1,
        'initial_sigma_heading_deg': 1.0,
    },
    # What is left of 1 deg/s and 20 mg of a BMI088 after a minute at rest: ours.
    'mems': {
        'imu': 'bmi088',
        'gyro_bias_dph': 50.0,
        'accel_bias_g': 5e-3,
        'initial_sigma_tilt_deg': 0.3,
        'initial_sigma_heading_deg': 3.0,
    },
}
"""IMU and start by class: white noise of the instrument, sigmas of its constants."""
POLES = {'north': 'over_pole', 'south': 'south_pole'}
DELAYS = {
    '0': FixSpec(),
    '10': FixSpec(delay_s=10.0),
    '30': FixSpec(delay_s=30.0),
    '60': FixSpec(delay_s=60.0),
    '0-60': FixSpec(delay_kind='uniform', delay_s=60.0),
}
"""Delay of fixes [s]; the last is uniform, so that fixes come out of order."""
COLUMNS: dict[str, dict[str, Any]] = {
    'default': {'configuration': 'default'},
    'in_order': {
        'configuration': 'custom',
        'delay_handling': 'rewind',
        'noise_adaptation': CONFIGURATIONS['default'].noise_adaptation,
        'gate_probability': CONFIGURATIONS['default'].gate_probability,
        'robust_fixes': CONFIGURATIONS['default'].robust_fixes,
    },
}
_DVL_HZ = {'dvl': 5.0, 'no_dvl': 0.0}


def cases(duration_s: float) -> list[Case]:
    """Return every class, with and without DVL, at both poles, at each delay."""
    out = []
    for (imu, spec), (dvl, rate_hz), (pole, mission), (delay, fixes) in product(
        CLASSES.items(), _DVL_HZ.items(), POLES.items(), DELAYS.items()
    ):
        world = WorldSpec(
            duration_s=duration_s,
            mission=mission,
            constants='prior',
            imu_vices=False,
            dvl_rate_hz=rate_hz,
            depth_rate_hz=5.0,
            **spec,
        )
        timed = FixSpec(
            period_s=2.0, first_s=2.0, delay_kind=fixes.delay_kind, delay_s=fixes.delay_s
        )
        out.append(
            Case(
                f'{imu}_{dvl}_{pole}_{delay}',
                SinsScene(world, timed),
                COLUMNS,
                watched=False,
                about={'imu': imu, 'dvl': dvl, 'pole': pole, 'delay': delay},
            )
        )
    return out


def judged_otherwise(a: Sequence[RunResult], b: Sequence[RunResult]) -> tuple[int, int]:
    """Fixes that one filter fused and the other did not, and all fixes, over equal seeds."""
    other = {r.seed: r.series['fused'] for r in b}
    pairs = [(r.series['fused'], other[r.seed]) for r in a if r.seed in other]
    differ = sum(int((x[: len(y)] != y[: len(x)]).sum()) for x, y in pairs)
    return differ, sum(len(x) for x, _ in pairs)


def tables(chosen: Sequence[Case], results: Sequence[RunResult], size: Size) -> list[Table]:
    """Return the table of ratios, NEES and verdicts."""
    columns = (
        Column('imu', 'IMU'),
        Column('dvl', 'DVL'),
        Column('pole', 'pole'),
        Column('delay', 'delay', 's'),
        Column('rms', 'default', 'm'),
        Column('reference', 'in order', 'm'),
        Column('ratio', 'ratio', digits=5),
        Column('spread', 'of single seeds'),
        *NEES_COLUMNS,
        Column('otherwise', 'judged otherwise'),
        Column('met', f'at most {GOAL}'),
    )
    rows = []
    for case in chosen:
        late, reference = of(results, case, 'default'), of(results, case, 'in_order')
        differ, fixes = judged_otherwise(late, reference)
        rows.append(
            {
                **case.about,
                'rms': rms(late),
                'reference': rms(reference),
                'spread': spread_of_ratio(late, reference),
                **nees_cells(late),
                'otherwise': f'{differ} of {fixes}',
                **ratio_cells(late, reference, GOAL),
            }
        )
    met = sum(bool(row.get('met')) for row in rows)
    note = (
        f'{met} of {len(rows)} rows at most {GOAL}. A fix of 1 m every 2 s, 3 m/s, stated IMU'
        ' noise and biases exact; horizontal RMS of the second half, pooled over seeds. '
        + nees_note(size.seeds)
    )
    return [Table('Late fixes: default against in order', columns, tuple(rows), note)]


LATE: Experiment = experiment_of(
    'late',
    'Late fixes to 60 s, four IMUs, both poles: the default against processing in order',
    (Size(600.0, 20), Size(200.0, 1)),
    cases,
    tables,
)
