"""Experiment `spoof`: forged and repeated packets, their effect, the time to the first warning.

A packet has a CRC, which anybody can compute. The world is that of the experiment `mismatch`
(6.1 IMU, 3 m/s, a fix of 1 m per 2 s, 1.5 to 4 s late); the spoof begins after ten minutes.
Drifts come again with the other classes of IMU, which decide how long they stay hidden.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.errors import ConfigError

from ..scoring.tables import Column, Table
from .choices import Choices
from .columns import filter_columns
from .evidence.late import CLASSES
from .experiment import Experiment
from .jobs import RunResult
from .mismatch.faults import FixOffset
from .mismatch.health import health_history
from .mismatch.judge import WARN
from .mismatch.plan import as_stated
from .mismatch.row import SINS, scene_of
from .mismatch.scenes import SinsScene
from .mismatch.visible import visibility
from .request import Request, Size
from .suite import POLAR, Paper
from .world import World
from .world_spec import WorldSpec

START_S = 600.0
VISIBLE = 'visible'
COLUMNS = ('default', 'modified_akf', 'conventional_akf')
_NS = 1_000_000_000


@dataclass(frozen=True)
class Spoof:
    """One kind of forged packets: what they do to a world, and in one sentence."""

    name: str
    doc: str
    applied: Callable[[World], World]
    shape: FixOffset | None = None
    """The same as a fault, where a test that knows its shape can be made."""
    scene: SinsScene = SINS


def _offset(name: str, doc: str, **size: Any) -> Spoof:  # noqa: ANN401 - of FixOffset
    shape = FixOffset(start_s=START_S, **size)
    return Spoof(name, doc, lambda world: shape.applied(world, 1.0), shape)


def _drifts_of(imu: str) -> list[Spoof]:
    """Drifts for a follower with an IMU of this class."""
    scene = scene_of(imu_vices=False, **CLASSES[imu])
    found = [
        _offset(f'drift_{mps:g}mps_{imu}', f'drift of {mps:g} m/s, IMU {imu}', drift_mps=mps)
        for mps in (0.02, 0.05, 0.1, 0.3)
    ]
    return [replace(spoof, scene=scene) for spoof in found]


def _late(world: World) -> list[Fix]:
    """Fixes that are valid after the start of the spoof."""
    begin_ns = world.truth.start_ns + round(START_S * _NS)
    return [f for f in world.inputs.fixes if f.validity_ns >= begin_ns]


def _with(world: World, added: Sequence[Fix], changed: Mapping[int, Fix] | None = None) -> World:
    """World with more fixes, and others in place of some by their number, in order of arrival."""
    changed = changed or {}
    fixes = [*(changed.get(f.sequence, f) for f in world.inputs.fixes), *added]
    fixes.sort(key=lambda f: (f.receive_ns, f.order))
    return world.with_fixes(tuple(replace(f, arrival=k) for k, f in enumerate(fixes)))


def _replayed(world: World) -> World:
    """Each fix 20 times more, under numbers of its own."""
    copies = [
        replace(f, sequence=100_000 * k + f.sequence, receive_ns=f.receive_ns + k * 50_000_000)
        for f in _late(world)
        for k in range(1, 21)
    ]
    return _with(world, copies)


def _burnt(world: World) -> World:
    """The numbers of all fixes to come, at once, 5 km off."""
    first, *rest = _late(world)
    forged = [
        replace(
            f,
            validity_ns=first.validity_ns + (k + 1) * 100_000,
            receive_ns=first.receive_ns + (k + 1) * 1000,
            r_e=f.r_e + 5000.0 * np.ones(3) / math.sqrt(3.0),
        )
        for k, f in enumerate(rest)
    ]
    return _with(world, forged)


def _restated(sigma: float, away_m: float) -> Callable[[World], World]:
    """Fixes so far off with so large a stated sigma."""

    def applied(world: World) -> World:
        changed = {
            f.sequence: replace(
                f,
                r_e=f.r_e + away_m * np.ones(3) / math.sqrt(3.0),
                covariance_e=sigma**2 * np.eye(3),
            )
            for f in _late(world)
        }
        return _with(world, (), changed)

    return applied


def _indefinite(world: World) -> World:
    """One packet with correlations (1, 1, -1)."""
    fix = _late(world)[0]
    covariance_e = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]])
    return _with(world, (), {fix.sequence: replace(fix, covariance_e=covariance_e)})


SPOOFS = (
    Spoof('none', 'no spoof', lambda world: world),
    _offset('packet_5km', 'one packet 5 km off', offset_m=5000.0, length_s=2.0),
    _offset('jump_20m', 'all 20 m off', offset_m=20.0),
    _offset('jump_500m', 'all 500 m off', offset_m=500.0),
    _offset('jump_20km', 'all 20 km off', offset_m=20_000.0),
    *(
        _offset(f'drift_{mps:g}mps', f'drift of {mps:g} m/s', drift_mps=mps)
        for mps in (0.005, 0.01, 0.02, 0.05, 0.1, 0.3, 1.0)
    ),
    Spoof('replay_20', 'each packet 20 times more, other numbers', _replayed),
    Spoof('burnt_numbers', 'numbers to come used up by packets 5 km off', _burnt),
    Spoof('sigma_5mm', 'true position with a sigma of 5 mm', _restated(0.005, 0.0)),
    Spoof('sigma_13km', '1 km off with a sigma of 13 km', _restated(13_000.0, 1000.0)),
    Spoof('indefinite', 'one packet with an indefinite covariance', _indefinite),
    *(spoof for imu in CLASSES for spoof in _drifts_of(imu)),
)


@dataclass(frozen=True)
class SpoofJob:
    """One run to make: of a filter, or with the column `VISIBLE` of the best test."""

    spoof: str
    column: str
    seed: int
    changes: Mapping[str, Any] = field(default_factory=dict)


def _plan(request: Request, size: Size, columns: Sequence[str]) -> list[SpoofJob]:
    if request.duration_s is not None:
        raise ConfigError('--duration: spoof has its own')
    known = filter_columns(request.choices)
    engine = dict(request.choices.engine)
    jobs = [SpoofJob(s.name, VISIBLE, 1) for s in SPOOFS if s.shape is not None]
    for seed in range(1, size.seeds + 1):
        for spoof in SPOOFS:
            jobs += [
                SpoofJob(
                    spoof.name, name, seed, {**as_stated('sins'), **known[name].changes, **engine}
                )
                for name in columns
            ]
    return jobs


_newest: list[tuple[WorldSpec, int, World]] = []


def _world(scene: SinsScene, seed: int) -> World:
    """World of a scene and a seed without a spoof; the newest is kept."""
    if not _newest or _newest[0][:2] != (scene.world, seed):
        _newest[:] = [(scene.world, seed, scene.make(seed))]
    return _newest[0][2]


def run_job(job: SpoofJob) -> RunResult:
    """Result of one run: errors from the spoof on, and the time to the first warning."""
    spoof = next(s for s in SPOOFS if s.name == job.spoof)
    begin = time.process_time()
    if job.column == VISIBLE:
        assert spoof.shape is not None
        seen = visibility(spoof.scene, spoof.shape, job.seed)
        metrics = {'visible_s': seen.from_s - START_S}
        seconds = time.process_time() - begin
        return RunResult(job.spoof, VISIBLE, job.seed, metrics, math.nan, '', {}, seconds)
    world = spoof.applied(_world(spoof.scene, job.seed))
    ran = spoof.scene.run(world, job.changes)
    start_ns = spoof.scene.start_ns(world)
    end_ns = int(ran.stamps_ns[-1])
    history = health_history(ran.health, end_ns, ran.divergence)
    spoofed_ns = start_ns + round(START_S * _NS)
    warned = [r for r in history if r.stamp_ns >= spoofed_ns and r.level >= WARN]
    before = [r for r in history if r.stamp_ns < spoofed_ns]
    late = ran.course.time_s >= START_S
    error = np.hypot(*ran.course.position.error[late, :2].T)
    warned_s = (warned[0].stamp_ns - spoofed_ns) * 1e-9 if warned else math.nan
    reported = ran.course.time_s[late] >= START_S + warned_s
    metrics = {
        'rms_m': float(np.sqrt(np.mean(error**2))),
        'most_m': float(error.max()),
        'end_m': float(error[-1]),
        'ratio': float(ran.course.position.ratio()[late].max()),
        'warned_s': warned_s,
        'warned_m': float(error[reported][0]) if reported.any() else math.nan,
        'warned_before': float(bool(before) and before[-1].level >= WARN),
    }
    verdicts = Counter(
        Verdict(r.verdict).name for r in ran.receipts if r.source and r.stamp_ns >= spoofed_ns
    )
    return RunResult(
        job.spoof,
        job.column,
        job.seed,
        metrics,
        (end_ns - start_ns) * 1e-9 if ran.divergence else math.nan,
        ran.divergence,
        dict(verdicts),
        time.process_time() - begin,
    )


_COLUMNS = (
    Column('spoof', 'packets'),
    Column('filter', 'filter'),
    Column('rms_m', 'RMS', 'm', doc='horizontal, from the spoof on, pooled over seeds'),
    Column('most_m', 'largest', 'm', doc='of all seeds'),
    Column('end_m', 'at the end', 'm', doc='largest of all seeds'),
    Column('ratio', 'in σ', doc='largest error in its own sigma'),
    Column('warned', 'warned', doc='seeds with a WARN or ERROR after the spoof began'),
    Column('warned_s', 'after', 's', doc='median of them'),
    Column('latest_s', 'latest', 's', doc='of them'),
    Column('warned_m', 'error then', 'm', doc='median of them'),
    Column('visible_s', 'best test', 's', doc='until the innovations show it by 5 sigma'),
    Column('verdicts', 'verdicts', doc='of all packets since, all seeds'),
)


def _tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    del request
    seen = {r.group: r.metrics['visible_s'] for r in results if r.column == VISIBLE}
    runs: dict[tuple[str, str], list[RunResult]] = {}
    for r in results:
        if r.column != VISIBLE:
            runs.setdefault((r.group, r.column), []).append(r)
    body = []
    for spoof in SPOOFS:
        for (name, column), found in runs.items():
            if name == spoof.name:
                line = _line(spoof, column, found)
                if name in seen:
                    line['visible_s'] = seen[name]
                body.append(line)
    return [Table(f'Spoofed packets, seeds 1 to {size.seeds}', _COLUMNS, tuple(body))]


def _line(spoof: Spoof, column: str, runs: Sequence[RunResult]) -> dict[str, object]:
    def all_of(key: str) -> list[float]:
        return [r.metrics[key] for r in runs]

    warned = [s for s in all_of('warned_s') if not math.isnan(s)]
    verdicts = sum((Counter(r.verdicts) for r in runs), Counter[str]())
    line: dict[str, object] = {
        'spoof': spoof.doc,
        'filter': column,
        'rms_m': math.sqrt(float(np.mean(np.square(all_of('rms_m'))))),
        'most_m': max(all_of('most_m')),
        'end_m': max(all_of('end_m')),
        'ratio': max(all_of('ratio')),
        'warned': f'{len(warned)}/{len(runs)}',
        'verdicts': ', '.join(f'{n} {name}' for name, n in sorted(verdicts.items())),
    }
    if warned:
        line['warned_s'] = float(np.median(warned))
        line['latest_s'] = max(warned)
        line['warned_m'] = float(np.nanmedian(all_of('warned_m')))
    return line


def _long_table(title: str, results: Sequence[RunResult], paper: Paper | None) -> Table:
    del paper
    keys = list(dict.fromkeys(k for r in results for k in r.metrics))
    columns = (Column('spoof', 'spoof'), Column('filter', 'filter'), Column('seed', 'seed'))
    rows = [{'spoof': r.group, 'filter': r.column, 'seed': r.seed, **r.metrics} for r in results]
    return Table(title, (*columns, *(Column(k, k) for k in keys)), tuple(rows))


def _describe(jobs: Sequence[SpoofJob]) -> dict[str, Any]:
    return {
        'filters': {job.column: {'engine': dict(job.changes)} for job in jobs},
        'groups': {s.name: {'about': s.doc, 'start_s': START_S} for s in SPOOFS},
    }


def _present(names: Sequence[str]) -> list[str]:
    known = filter_columns(Choices())
    return [name for name in names if name in known]


SPOOF = Experiment(
    'spoof',
    'Forged and repeated packets: effect, and time to the first warning',
    Size(1200.0, 20),
    Size(1200.0, 1),
    COLUMNS,
    _plan,
    _tables,
    suite=replace(
        POLAR,
        present=_present,
        run_job=run_job,
        long_table=_long_table,
        describe=_describe,
    ),
)
