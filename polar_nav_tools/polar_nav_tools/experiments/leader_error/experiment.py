"""The experiment `leader-error`: a follower of a leader that is off itself.

Filters: ``default``; ``independent``, which takes the error of each fix for its own
(``leader_error_tau`` 0); ``perfect``, the default with the leader's error taken out of the fixes
and of what they state, which is what no real leader can give.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.error_model import X
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid

from ...scoring.consistency import chi_square_band
from ...scoring.tables import Column, Table
from ..choices import choices_from
from ..errors import track_errors
from ..experiment import Experiment
from ..jobs import RunResult
from ..request import Request, Size, rows_matching
from ..suite import Paper, engine_suite
from ..world_spec import WorldSpec
from .leader import Leader, make_leader_world

if TYPE_CHECKING:
    pass

FILTERS: dict[str, dict[str, Any]] = {
    'default': {},
    'independent': {'leader_error_tau': 0.0},
    'perfect': {},
}
_WORLD = WorldSpec(
    constants='prior',
    dvl_scale=0.004,
    dvl_rate_hz=5.0,
    depth_rate_hz=5.0,
    initial_sigma_position=5.0,
)
_PROBABILITY = 0.999


@dataclass(frozen=True)
class Scenario:
    """A leader, and how long the two vehicles sail; `mission` as of `WorldSpec`."""

    name: str
    leader: Leader
    duration_s: float
    mission: str = ''


_OCTANS_DEG = 0.1 / math.cos(math.radians(80.0))
"""0.1 deg sec(latitude) at 80 degrees."""
_PERFECT = Leader(0.0, 0.0, 0.0, start_m=0.0)
_LONG, _SHORT = 7200.0, 1800.0
SCENARIOS = (
    Scenario('0.07 %, 30 min', Leader().drift(7e-4), _SHORT),
    Scenario('0.07 %, 2 h', Leader().drift(7e-4), _LONG),
    Scenario('0.5 %, 30 min', Leader().drift(5e-3), _SHORT),
    Scenario('0.5 %, 2 h', Leader().drift(5e-3), _LONG),
    Scenario('0.5 %, racetrack', Leader().drift(5e-3), _LONG, 'racetrack'),
    Scenario('gyrocompass, 0.6 km', Leader(array_deg=_OCTANS_DEG, range_m=600.0), _LONG),
    Scenario('gyrocompass, 2 km', Leader(array_deg=_OCTANS_DEG, range_m=2000.0), _LONG),
    Scenario(
        'gyrocompass, circling',
        Leader(array_deg=_OCTANS_DEG, range_m=1500.0, place='circling'),
        _LONG,
    ),
    # One that was to starboard would come back near its start by chance only.
    Scenario(
        'gyrocompass, racetrack',
        Leader(array_deg=_OCTANS_DEG, place='east'),
        _LONG,
        'racetrack',
    ),
    Scenario('3 m, constant', replace(_PERFECT, start_m=3.0), _LONG),
    Scenario('perfect', _PERFECT, _SHORT),
)

_COLUMNS = (
    Column('row', 'leader'),
    Column('filter', 'filter'),
    Column('rms_m', 'RMS', 'm', doc='horizontal, second half, pooled over seeds'),
    Column('said_m', 'said', 'm', doc='published horizontal sigma, pooled'),
    Column('position', 'NEES position', doc='per degree of freedom at the end, mean over seeds'),
    Column('heading', 'NEES heading', doc='at the end, mean over seeds'),
    Column('half_position', 'position, 2nd half', doc='the same, mean over the second half'),
    Column('half_heading', 'heading, 2nd half'),
    Column('nis', 'NIS', doc='of fixes, per degree of freedom, whole run'),
    Column('fused', 'fused', '%'),
    Column('inside', 'in band', doc='both ends in the 99.9 % band of so many seeds'),
)


@dataclass(frozen=True)
class LeaderJob:
    """One run: of a scenario, by a filter."""

    scenario: Scenario
    filter: str
    seed: int
    duration_s: float
    changes: Mapping[str, Any] = field(default_factory=dict)


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[LeaderJob]:
    """All filters of a scenario at one seed after another; `size` cuts longer runs."""
    names = rows_matching(request.rows, (s.name for s in SCENARIOS))
    chosen = [s for s in SCENARIOS if s.name in names]
    return [
        LeaderJob(s, name, seed, min(s.duration_s, size.duration_s), dict(request.choices.engine))
        for s in chosen
        for seed in range(request.first_seed, request.first_seed + size.seeds)
        for name in columns
    ]


def run_job(job: LeaderJob) -> RunResult:
    """Run one filter and measure it."""
    spec = replace(_WORLD, duration_s=job.duration_s, mission=job.scenario.mission)
    leader = _PERFECT if job.filter == 'perfect' else job.scenario.leader
    leader = replace(leader, range_m=job.scenario.leader.range_m)
    world = make_leader_world(spec, leader, job.seed)
    params = world.params(
        configuration='default', output_period_s=10.0, **FILTERS[job.filter], **job.changes
    )
    start = time.process_time()
    result = engine_run.run(params, world.inputs)
    seconds = time.process_time() - start
    e = track_errors(world, result.track)
    half = e.rows(e.time_s > 0.5 * e.time_s[-1])
    heading = half.phi_G[:, 2] ** 2 / half.P[:, 2, 2]
    position = half.nees_position() / 3.0
    C_e_G = ecef_to_grid(result.track.r_e[-len(heading) :])
    P_G = np.einsum('nij,njk,nlk->nil', C_e_G, half.P[:, X.dr_e, X.dr_e], C_e_G)
    fixes = [r for r in result.receipts if r.topic == 'acomms/rx']
    fused = [r for r in fixes if r.verdict == Verdict.FUSED]
    metrics = {
        'square': float(np.mean(half.horizontal**2)),
        'said': float(np.mean(P_G[:, 0, 0] + P_G[:, 1, 1])),
        'position': float(position[-1]),
        'heading': float(heading[-1]),
        'half_position': float(position.mean()),
        'half_heading': float(heading.mean()),
        'nis': float(np.mean([r.nis for r in fused])) / 3.0,
        'fused': 100.0 * len(fused) / max(len(fixes), 1),
    }
    counts = Counter(Verdict(r.verdict).name for r in fixes)
    return RunResult(
        job.scenario.name,
        job.filter,
        job.seed,
        metrics,
        float('nan') if not result.divergence else job.duration_s,
        result.divergence,
        dict(counts),
        seconds,
    )


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """One row per scenario and filter."""
    first = request.first_seed
    grouped: dict[tuple[str, str], list[RunResult]] = {}
    for r in results:
        grouped.setdefault((r.group, r.column), []).append(r)
    rows = tuple(_line(*key, runs) for key, runs in grouped.items())
    title = f'Leader error, seeds {first} to {first + size.seeds - 1}'
    return [Table(title, _COLUMNS, rows, _note(size.seeds))]


def bands(seeds: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Bounds of the mean NEES per degree of freedom, of position and of heading."""
    found = []
    for dof in (3, 1):
        low, high = chi_square_band(dof * seeds, _PROBABILITY)
        found.append((float(low) / (dof * seeds), float(high) / (dof * seeds)))
    return found[0], found[1]


def _note(seeds: int) -> str:
    (a, b), (c, d) = bands(seeds)
    return (
        f'99.9 % band over seeds at the end: position {a:.2f} to {b:.2f}, heading {c:.2f} to '
        f'{d:.2f}. All fixes of 1 m, every 2 s, 1.5 to 4 s late, one in ten lost.'
    )


def _line(row: str, name: str, runs: Sequence[RunResult]) -> dict[str, object]:
    def mean(key: str) -> float:
        return float(np.mean([r.metrics[key] for r in runs]))

    ends = {key: mean(key) for key in ('position', 'heading')}
    limits = bands(len(runs))
    inside = all(low <= x <= high for x, (low, high) in zip(ends.values(), limits, strict=True))
    return {
        'row': row,
        'filter': name,
        'rms_m': math.sqrt(mean('square')),
        'said_m': math.sqrt(mean('said')),
        **ends,
        **{key: mean(key) for key in ('half_position', 'half_heading', 'nis', 'fused')},
        'inside': 'yes' if inside else 'no',
    }


def _read(settings: Sequence[str], columns: Sequence[str] | None) -> dict[str, Any]:
    for setting in settings:
        if not setting.strip().startswith('engine.'):
            raise ConfigError(f'--set {setting}: leader-error takes engine.PARAMETER only')
    for name in columns or ():
        if name not in FILTERS:
            raise ConfigError(f'--columns: no filter {name!r}; there are {", ".join(FILTERS)}')
    return {'choices': choices_from(settings)}


def _long_table(title: str, results: Sequence[RunResult], paper: Paper | None) -> Table:
    del paper
    keys = list(dict.fromkeys(k for r in results for k in r.metrics))
    columns = (Column('row', 'leader'), Column('filter', 'filter'), Column('seed', 'seed'))
    rows = [{'row': r.group, 'filter': r.column, 'seed': r.seed, **r.metrics} for r in results]
    return Table(title, (*columns, *(Column(k, k) for k in keys)), tuple(rows))


def _describe(jobs: Sequence[LeaderJob]) -> dict[str, Any]:
    return {
        'filters': {j.filter: {'engine': {**FILTERS[j.filter], **j.changes}} for j in jobs},
        'groups': {
            j.scenario.name: {**asdict(j.scenario), 'duration_s': j.duration_s} for j in jobs
        },
    }


LEADER_ERROR = Experiment(
    'leader-error',
    'Fixes that share the position and heading error of their leader: RMS, NEES, NIS',
    Size(_LONG, 20),
    Size(300.0, 1),
    tuple(FILTERS),
    plan,
    tables,
    suite=engine_suite(_read, run_job, _long_table, _describe),
    selects=True,
)
