"""One run of a filter in the world of a case, and its metrics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.verdicts import Verdict

from ..jobs import RunResult
from ..mismatch.health import health_history
from ..mismatch.judge import (
    COVERED_SIGMAS,
    ERROR,
    KINDS,
    WARN,
    Course,
    HealthReport,
    errors_of,
    onsets,
    share_at,
)
from ..mismatch.row import warm_scene
from ..mismatch.scenes import Ran, refused_shares
from .case import Case


@dataclass(frozen=True)
class EvidenceJob:
    """One run to make: a column of a case at a seed, with engine parameters set by `--set`."""

    case: Case
    column: str
    seed: int
    engine: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class EvidenceResult(RunResult):
    """Result of a run, with each rise of its health; stamps count from the start [ns]."""

    alarms: tuple[HealthReport, ...] = ()


_worlds: dict[tuple[str, int], Any] = {}
_warmed: set[str] = set()


def _world(case: Case, seed: int) -> Any:  # noqa: ANN401 - of either mode
    """World of a case at a seed; the newest is kept, for the columns of a seed follow it."""
    key = (f'{case.scene!r} {case.shape!r}', seed)
    if key not in _worlds:
        _worlds.clear()
        _worlds[key] = case.shape(case.scene.make(seed))
    return _worlds[key]


def _warm(mode: str) -> None:
    """Run a few seconds once per process and mode, to load compiled code before it is timed."""
    if mode not in _warmed:
        _warmed.add(mode)
        scene: Any = warm_scene(mode)
        scene.run(scene.make(1), {})


def run_job(job: EvidenceJob) -> EvidenceResult:
    """Result of one run."""
    case, scene = job.case, job.case.scene
    _warm(scene.mode)
    world: Any = _world(case, job.seed)
    start = time.process_time()
    changes = {**case.columns[job.column], **job.engine}
    ran = scene.run(world, changes, watched=case.watched)
    seconds = time.process_time() - start
    return _result(job, ran, scene.start_ns(world), seconds)


def _result(job: EvidenceJob, ran: Ran, start_ns: int, seconds: float) -> EvidenceResult:
    end_ns = int(ran.stamps_ns[-1]) if len(ran.stamps_ns) else start_ns
    history = health_history(ran.health, end_ns, ran.divergence)
    fused = {(r.source, r.sequence): r.verdict == Verdict.FUSED for r in ran.receipts if r.source}
    levels = _levels(history, ran.stamps_ns)
    metrics = {
        **errors_of(ran.course),
        **refused_shares(ran),
        **job.case.measure(ran.course),
        'hours': (end_ns - start_ns) / 3.6e12,
        'silent': silent_share(ran.course, levels),
        'warnings': float(onsets(history, WARN)),
        'errors': float(onsets(history, ERROR)),
        'error_share': share_at(history, ERROR, start_ns, end_ns),
    }
    return EvidenceResult(
        job.case.name,
        job.column,
        job.seed,
        metrics,
        (end_ns - start_ns) * 1e-9 if ran.divergence else float('nan'),
        ran.divergence,
        dict(Counter(Verdict(r.verdict).name for r in ran.receipts if r.source)),
        seconds,
        {'fused': np.array([v for _, v in sorted(fused.items())], dtype=np.float64)},
        alarms=tuple(r._replace(stamp_ns=r.stamp_ns - start_ns) for r in rises(history)),
    )


def rises(history: Sequence[HealthReport]) -> list[HealthReport]:
    """Reports at which the level rose."""
    before = [0, *(r.level for r in history)]
    return [r for r, last in zip(history, before, strict=False) if r.level > last]


def _levels(history: Sequence[HealthReport], stamps_ns: Array) -> Array:
    """Level at each estimate, shape (n,)."""
    since = np.array([r.stamp_ns for r in history], dtype=np.int64)
    levels = np.array([0, *(r.level for r in history)])
    return np.asarray(levels[np.searchsorted(since, stamps_ns, side='right')])


def silent_share(course: Course, levels: Array) -> float:
    """Share of a run beyond 3 published sigmas, in any quantity, while the level is below ERROR.

    The time after a filter stopped counts as ERROR: it publishes nothing.
    """
    if not len(course.time_s):
        return 0.0
    worst = np.max([getattr(course, kind).ratio() for kind in KINDS], axis=0)
    return float(np.mean((worst > COVERED_SIGMAS) & (levels < ERROR)))
