"""One run of a campaign: its world, its filter, its numbers."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.params import to_mapping
from polar_nav_follower.params import FollowerParams

from ..experiments.hold import messages
from ..experiments.hold.drive import drive
from ..experiments.hold.messages import params_of, start_ns_of, taken, with_faults
from ..experiments.jobs import RunResult
from ..experiments.mismatch.health import health_history
from ..experiments.mismatch.judge import (
    BEYOND_SIGMAS,
    ERROR,
    KINDS,
    WARN,
    WRONG_SHARE,
    Course,
    errors_of,
    is_wrong,
    onsets,
)
from ..experiments.mismatch.plan import as_stated
from ..experiments.mismatch.row import warm_scene
from ..experiments.mismatch.scenes import Ran, Scene, StationScene, refused_shares
from ..experiments.received import received
from ..tasks.keys import canonical
from .mission import as_file, files_of
from .spec import Point

MINUTE_S = 60.0


@dataclass(frozen=True)
class CampaignJob:
    """One run to make: a point at a seed."""

    point: Point
    seed: int
    group: str = ''

    def key_content(self) -> tuple[object, ...]:
        """What it computes: not what the point is called, but the files that it reads."""
        return self.point, self.seed, tuple(files_of(self.point.document))


_newest: dict[str, Any] = {}
_warmed: set[str] = set()


def scene_here(point: Point) -> Scene:
    """Scene of a point, its mission in a file of this machine."""
    mission = as_file(point.document)
    scene = point.scene
    if isinstance(scene, StationScene):
        return replace(scene, scenario=replace(scene.scenario, mission=mission))
    return replace(scene, world=replace(scene.world, mission=mission))


def world_of(point: Point, scene: Scene, seed: int) -> Any:  # noqa: ANN401 - of either mode
    """World of a point at a seed without a fault; the newest is kept."""
    key = repr((canonical(point.scene), canonical(point.document), seed))
    if key not in _newest:
        _newest.clear()
        _newest[key] = scene.make(seed)
    return _newest[key]


def run_job(job: CampaignJob) -> RunResult:
    """Result of one run of a filter."""
    point = job.point
    scene = scene_here(point)
    _warm(scene.mode)
    world: Any = world_of(point, scene, job.seed)
    fault: Any = point.mismatch
    world = fault.applied(world, 1.0)
    stated = {} if point.exact else as_stated(scene.mode)
    changes = {**stated, **point.engine, **fault.for_all}
    if point.injection is not None:
        return _driven(job, scene, world, changes)
    start = time.process_time()
    ran = scene.run(world, changes)
    seconds = time.process_time() - start
    return _result(job, ran, scene.start_ns(world), seconds)


def _driven(job: CampaignJob, scene: Scene, world: Any, changes: dict[str, Any]) -> RunResult:  # noqa: ANN401
    """Result of a run message by message, as the node takes them, with a fault in them."""
    assert job.point.injection is not None
    params = params_of(world, {**scene.changes, **changes})
    found = with_faults(taken(received(world.inputs)), [job.point.injection], job.seed)
    start_ns = start_ns_of(world)
    until_ns = start_ns + round(scene.duration_s * 1e9)
    start = time.process_time()
    trace = drive(FollowerParams(**to_mapping(params)), found, start_ns, until_ns).trace(until_ns)
    seconds = time.process_time() - start
    errors = messages.errors_of(world, trace, scene.duration_s)
    late = errors.time_s > 0.5 * scene.duration_s
    metrics = {
        'warnings': float(len({w.kind for w in trace.words if w.level == WARN})),
        'errors': float(len({w.kind for w in trace.words if w.level == ERROR})),
    }
    if late.any():
        beyond = float(np.mean(errors.sigmas()[late] > BEYOND_SIGMAS))
        metrics |= {
            'rms': float(np.sqrt(np.mean(errors.horizontal[late] ** 2))),
            'end': float(errors.horizontal[-1]),
            'said': float(np.sqrt(np.mean(errors.stated[late] ** 2))),
            'beyond_position': beyond,
            'wrong': float(beyond > WRONG_SHARE),
        }
    stopped_s = float(errors.time_s[-1]) if trace.ended and len(errors.time_s) else float('nan')
    return RunResult(
        job.group,
        params.configuration,
        job.seed,
        metrics,
        stopped_s,
        trace.ended,
        {'FUSED': len(trace.fused_s)},
        seconds,
    )


def _warm(mode: str) -> None:
    """Run a few seconds once per process and mode, so that loading of kernels is not timed."""
    if mode not in _warmed:
        _warmed.add(mode)
        scene: Any = warm_scene(mode)
        scene.run(scene.make(1), {})


def _result(job: CampaignJob, ran: Ran, start_ns: int, seconds: float) -> RunResult:
    end_ns = int(ran.stamps_ns[-1]) if len(ran.stamps_ns) else start_ns
    history = health_history(ran.health, end_ns, ran.divergence)
    metrics = {
        **errors_of(ran.course),
        **refused_shares(ran),
        'wrong': float(is_wrong(ran.course)),
        'warnings': float(onsets(history, WARN)),
        'errors': float(onsets(history, ERROR)),
    }
    for kind in KINDS:
        metrics[f'dof_{kind}'] = float(getattr(ran.course, kind).error.shape[1])
    return RunResult(
        job.group,
        ran.params.configuration,
        job.seed,
        metrics,
        (end_ns - start_ns) * 1e-9 if ran.divergence else float('nan'),
        ran.divergence,
        dict(Counter(Verdict(r.verdict).name for r in ran.receipts if r.source)),
        seconds,
        minutes_of(ran.course),
    )


def minutes_of(course: Course) -> dict[str, Array]:
    """NEES per degree of freedom and horizontal error [m] at the end of each minute."""
    if not len(course.time_s):
        return {}
    ends_s = np.arange(MINUTE_S, course.time_s[-1] + 1e-6, MINUTE_S)
    rows = np.minimum(np.searchsorted(course.time_s, ends_s), len(course.time_s) - 1)
    out = {'time_s': ends_s, 'horizontal': np.hypot(*course.position.error[rows, :2].T)}
    return {**out, **{f'nees_{k}': getattr(course, k).nees[rows] for k in KINDS}}
