"""One run of one filter in a row's world, and its data for the judge."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from polar_nav_core.engine.verdicts import Verdict

from ..jobs import RowJob, RunResult
from ..station.world import StationWorld
from ..world import World
from .health import health_history
from .judge import (
    ERROR,
    WARN,
    HealthReport,
    errors_of,
    first_wrong_s,
    is_covered,
    is_wrong,
    onsets,
    reported,
    share_at,
    silent_share,
)
from .row import Row, warm_scene
from .scenes import Ran, Scene, refused_shares
from .visible import visibility

BEST = 'best'
VISIBLE = 'visible'


class MismatchJob(RowJob[Row]):
    """One run to make: of a filter, or with the column `VISIBLE` of the fault's visibility."""


@dataclass(frozen=True, kw_only=True)
class MismatchResult(RunResult):
    """Result of a run, with the health that it reported.

    ``said_first`` is the first WARN or ERROR from the fault on, ``said_right`` the first that
    named a right culprit or nothing; stamps count from the start of the run [ns].
    """

    said_first: HealthReport | None = None
    said_right: HealthReport | None = None


@lru_cache(maxsize=1)
def _warm(mode: str) -> None:
    """Run the shortest row of a mode once per process, to load compiled code."""
    scene = warm_scene(mode)
    world: Any = scene.make(1)
    for configuration in ('default', 'modified_akf') if mode == 'sins' else ('default',):
        scene.run(world, {'configuration': configuration})
    scene.run(world, scene.best)


_worlds: dict[tuple[str, int], World | StationWorld] = {}


def _world(scene: Scene, seed: int) -> World | StationWorld:
    """World of a seed without a fault; the newest is kept, for jobs come scene by scene."""
    key = (repr(scene), seed)
    if key not in _worlds:
        _worlds.clear()
        _worlds[key] = scene.make(seed)
    return _worlds[key]


def run_job(job: MismatchJob) -> MismatchResult:
    """Result of one run of a filter, judged."""
    row = job.row
    _warm(row.scene.mode)
    if job.column == VISIBLE:
        start = time.process_time()
        seen = visibility(row.scene, row.fault, job.seed, job.changes)
        metrics = {'visible_s': seen.from_s, 'visible_sigmas': seen.sigmas}
        seconds = time.process_time() - start
        return MismatchResult(row.name, VISIBLE, job.seed, metrics, float('nan'), '', {}, seconds)
    world: Any = _world(row.scene, job.seed)
    fault = row.fault
    # The filter that knows the fault has inputs without it, or parameters that state it.
    knows = job.column == BEST
    faulty: Any = fault.applied(world, 0.0 if knows and not fault.known else 1.0)
    changes = {**job.changes, **fault.for_all, **(fault.known if knows else {})}
    start = time.process_time()
    ran = row.scene.run(faulty, changes)
    seconds = time.process_time() - start
    return _judged(job, ran, row.scene.start_ns(faulty), seconds)


def _judged(job: MismatchJob, ran: Ran, start_ns: int, seconds: float) -> MismatchResult:
    row = job.row
    end_ns = int(ran.stamps_ns[-1]) if len(ran.stamps_ns) else start_ns
    history = health_history(ran.health, end_ns, ran.divergence)
    fault_ns = start_ns + round(row.fault.start_s * 1e9)
    words = reported(history, fault_ns, row.culprits)
    wrong = is_wrong(ran.course)
    metrics = {
        **errors_of(ran.course),
        **refused_shares(ran),
        'wrong': float(wrong),
        'covered': float(is_covered(ran.course)),
        'silent': silent_share(ran.course, history, start_ns),
        'wrong_s': first_wrong_s(ran.course, row.fault.start_s),
        'warnings': float(onsets(history, WARN)),
        'errors': float(onsets(history, ERROR)),
        'error_share': share_at(history, ERROR, fault_ns, end_ns),
        'ends_in_error': float(history[-1].level >= ERROR) if history else 0.0,
        'first_s': _since(words.first, start_ns),
        'named_s': _since(words.named, start_ns),
    }
    verdicts = Counter(Verdict(r.verdict).name for r in ran.receipts if r.source)
    return MismatchResult(
        row.name,
        job.column,
        job.seed,
        metrics,
        (end_ns - start_ns) * 1e-9 if ran.divergence else float('nan'),
        ran.divergence,
        dict(verdicts),
        seconds,
        said_first=_from_start(words.first, start_ns),
        said_right=_from_start(words.named, start_ns),
    )


def _since(report: HealthReport | None, start_ns: int) -> float:
    return float('nan') if report is None else (report.stamp_ns - start_ns) * 1e-9


def _from_start(report: HealthReport | None, start_ns: int) -> HealthReport | None:
    return None if report is None else report._replace(stamp_ns=report.stamp_ns - start_ns)
