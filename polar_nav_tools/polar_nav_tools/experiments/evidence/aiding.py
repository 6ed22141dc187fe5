"""DVL lost for five minutes: with the model of the vehicle, at each q_c, and without.

Truth, IMU, DVL and fixes are the simulation's; navigation has the wrong model of the DVL-less
paper's vehicle. Fixes go on in the gap, or do not. Between `gap` and `before` stands what a gap
costs; between columns, what the model brings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.inputs import Stamps
from polar_nav_sim.dynamics.truth import DynamicTruth

from ...scoring.tables import Column, Table, show
from ..experiment import Experiment
from ..jobs import RunResult
from ..mismatch import worlds
from ..mismatch.judge import Course
from ..mismatch.scenes import SinsScene
from ..request import Size
from ..schedule import FixSpec
from ..world import World
from ..world_spec import WorldSpec
from .case import Case
from .plan import experiment_of, of
from .pooled import band, rms, values

GAP_S = (600.0, 900.0)
DURATION_S = 920.0
SETTLED_S = 300.0
IMUS = ('paper_6_1', 'paper_6_2')
_FIX = FixSpec(period_s=2.5, first_s=1.0, delay_s=2.0)
_NONE: dict[str, Any] = {'configuration': 'default'}
COLUMNS: dict[str, dict[str, Any]] = {
    'no model': _NONE,
    'default q_c': {**_NONE, 'model_aiding': True},
    'q_c 1e-6': {**_NONE, 'model_aiding': True, 'current_walk': 1e-6},
}


@dataclass(frozen=True)
class Gap:
    """Adds thrust to a world, and takes DVL, and fixes if so, away in the gap."""

    fixes: bool

    def __call__(self, world: World) -> World:
        """World with the gap."""
        i, start_ns = world.inputs, world.truth.start_ns
        t = worlds.seconds(world, i.dvl_stamps_ns)
        first_ns, last_ns = (start_ns + round(t * 1e9) for t in GAP_S)
        stamps, force_b = _thrust(world.spec)
        changed = replace(
            i,
            dvl_valid=i.dvl_valid & ~((t >= GAP_S[0]) & (t < GAP_S[1])),
            control_stamps_ns=stamps,
            control_force_b=force_b,
            control_torque_b=np.zeros_like(force_b),
            fixes=tuple(
                f for f in i.fixes if self.fixes or not first_ns <= f.validity_ns < last_ns
            ),
        )
        return replace(world, inputs=changed)


@lru_cache(maxsize=1)
def _thrust(spec: WorldSpec) -> tuple[Stamps, Array]:
    """Stamps and forces of the thrust, ten a second; the same at every seed."""
    mission = spec.plan()
    truth = mission.truth(mission.followers[0])
    if not isinstance(truth, DynamicTruth):
        raise TypeError(f'{spec.mission}: the vehicle has no dynamics')
    stamps = mission.start_ns + 10**8 * np.arange(round(10.0 * spec.duration_s), dtype=np.int64)
    return stamps, np.array([truth.thrust(int(s))[:3] for s in stamps])


def measure(course: Course) -> dict[str, float]:
    """Return horizontal RMS before and in the gap, error and NEES at its end."""
    t = course.time_s
    horizontal = np.hypot(course.position.error[:, 0], course.position.error[:, 1])
    end = max(0, int(np.searchsorted(t, GAP_S[1] - 0.1)) - 1)
    out = {}
    for name, first, last in (('before', SETTLED_S, GAP_S[0]), ('gap', *GAP_S)):
        rows = (t >= first) & (t < last)
        if rows.any():
            out[name] = float(np.sqrt(np.mean(horizontal[rows] ** 2)))
    if len(t):
        out['gap_end'] = float(horizontal[end])
        out['gap_nees'] = float(course.position.nees[end])
    return out


def cases(duration_s: float) -> list[Case]:
    """Return both IMUs, with and without fixes in the gap; of a length of their own."""
    del duration_s
    mission = str(files(__package__).joinpath('aiding.yaml'))
    out = []
    for imu in IMUS:
        world = WorldSpec(
            duration_s=DURATION_S,
            mission=mission,
            imu=imu,
            imu_rate_hz=100.0,
            constants='prior',
            dvl_rate_hz=5.0,
        )
        scene = SinsScene(world, _FIX)
        for fixes in (True, False):
            name = f'{imu.removeprefix("paper_")}_{"fixes" if fixes else "no_fixes"}'
            gap = Gap(fixes)
            out.append(Case(name, scene, COLUMNS, shape=gap, measure=measure, watched=False))
    return out


def tables(chosen: Sequence[Case], results: Sequence[RunResult], size: Size) -> list[Table]:
    """Return the table of the gap."""
    columns = (
        Column('case', 'IMU, fixes in the gap'),
        Column('model', 'model'),
        Column('before', 'before, RMS', 'm'),
        Column('gap', 'gap, RMS', 'm'),
        Column('ratio', 'ratio of the pooled RMS'),
        Column('ratios', 'of single seeds: median, lowest to highest'),
        Column('end', 'end of the gap, RMS', 'm'),
        Column('worst', 'worst seed', 'm'),
        Column('nees', 'NEES position at the end'),
    )
    rows = []
    for case in chosen:
        for column in case.columns:
            if runs := of(results, case, column):
                rows.append({'case': case.name, 'model': column, **_row(runs)})
    low, high = band(size.seeds, 3)
    note = (
        f'No DVL from {GAP_S[0]:g} to {GAP_S[1]:g} s of {DURATION_S:g} s; before is from'
        f' {SETTLED_S:g} s on. NEES per degree of freedom; * is outside the 99.9 % band of'
        f' seeds x 3, {low:.2f} to {high:.2f}.'
    )
    return [Table('DVL lost for five minutes', columns, tuple(rows), note)]


def _row(runs: Sequence[RunResult]) -> dict[str, object]:
    single = values(runs, 'gap') / values(runs, 'before')
    low, high = band(len(runs), 3)
    nees = float(values(runs, 'gap_nees').mean())
    return {
        'before': rms(runs, 'before'),
        'gap': rms(runs, 'gap'),
        'ratio': rms(runs, 'gap') / rms(runs, 'before'),
        'ratios': f'{show(np.median(single))} ({show(single.min())} to {show(single.max())})',
        'end': rms(runs, 'gap_end'),
        'worst': float(values(runs, 'gap_end').max()),
        'nees': show(nees) + ('' if low <= nees <= high else ' *'),
    }


AIDING: Experiment = experiment_of(
    'aiding',
    'DVL lost for five minutes: with the model of the vehicle and without; docs/model-aiding.md',
    (Size(DURATION_S, 20), Size(DURATION_S, 1)),
    cases,
    tables,
)
