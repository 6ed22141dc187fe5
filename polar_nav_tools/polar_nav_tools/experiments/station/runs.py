"""One run of one filter on the station scenario, and its metrics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.error_model import X
from polar_nav_core.identification.published import Samples, track_and_slopes
from polar_nav_core.identification.result import Identification, IdentificationVerdict
from polar_nav_core.identification.window import Log, make_window
from polar_nav_sim.offline_station import StationScenario

from ..jobs import RunResult
from ..station_choices import StationChoices
from .columns import StationColumn
from .errors import ADAPTED_S, AFTER, AXES, StationErrors, measure
from .world import NS, StationWorld, heading_and_pitch, make_world

_SERIES_S = 1.0
"""Interval of the points of a stored time series [s]."""
_LOG_EVERY = 10
"""Samples at 100 Hz between rows of an identification's log."""
_GAP_S = 5.0


@dataclass(frozen=True)
class StationJob:
    """One run to make: filter, scenario, seed.

    Attributes
    ----------
    group : str
        Group of the run besides the filter.
    column : StationColumn
        The filter.
    seed : int
    scenario : StationScenario
    choices : StationChoices
    later_s : float
        Delay of packets beyond the acoustic one [s].
    series : bool
        Whether errors over time are stored.
    """

    group: str
    column: StationColumn
    seed: int
    scenario: StationScenario
    choices: StationChoices
    later_s: float = 0.0
    series: bool = False


@lru_cache(maxsize=1)
def _warm() -> None:
    """Run a few seconds once per process, to load compiled code."""
    choices = StationChoices()
    world = make_world(StationScenario(duration_s=10.0), 1, choices.depth_sigma, 0.0)
    engine_run.run(world.params(choices, 0.0), world.inputs)


def run_job(job: StationJob) -> RunResult:
    """Result of one run of a filter."""
    _warm()
    world = make_world(job.scenario, job.seed, job.choices.depth_sigma, job.later_s)
    params = world.params(job.choices, job.later_s, **job.column.changes)
    inputs = world.as_of_arrival() if job.column.uncompensated else world.inputs
    start = time.process_time()
    result = engine_run.run(params, inputs)
    seconds = time.process_time() - start
    receipts = last_receipts(result.receipts)
    verdicts = Counter(Verdict(r.verdict).name for r in receipts)
    metrics: dict[str, float] = {}
    series: dict[str, Array] = {}
    stopped_s = float('nan')
    if result.divergence:
        stopped_s = float(result.track.stamps_ns[-1] - world.run.start_ns) / NS
    elif len(result.track.stamps_ns):
        states = body_states(world, result.track)
        errors = station_errors(world, states, receipts)
        metrics = {**measure(errors), **_ratios(errors)}
        metrics |= _identified(world, result, params)
        if job.series:
            series = _series(world, states, errors)
            series |= _tracks(world, result.identifications)
    run = job.group, job.column.name, job.seed
    return RunResult(*run, metrics, stopped_s, result.divergence, dict(verdicts), seconds, series)


def last_receipts(receipts: Sequence[Receipt]) -> list[Receipt]:
    """Last receipt of every fix; a revision can change a verdict."""
    last = {(r.source, r.sequence): r for r in receipts if r.source}
    return list(last.values())


@dataclass(frozen=True)
class BodyStates:
    """Estimates and truth at the stamps of a track.

    Attributes
    ----------
    time_s : (n,) array
    position, true_position : (n, 2) arrays
        Station frame [m].
    velocity_b, true_velocity_b : (n, 2) arrays
        Over ground [m/s]; each by its own attitude, so that their difference is the error of the
        body velocity without the AHRS' noise times the speed.
    covariance : (n, 2, 2) array
        Of position [m^2].
    """

    time_s: Array
    position: Array
    true_position: Array
    velocity_b: Array
    true_velocity_b: Array
    covariance: Array


def body_states(world: StationWorld, track: engine_run.StationTrack) -> BodyStates:
    """Estimates of a track and the truth at its stamps."""
    run = world.run
    row = np.searchsorted(run.t_s, (track.stamps_ns - run.start_ns) / NS - 1e-6)
    row = np.minimum(row, len(run.t_s) - 1)
    position = (track.r_e - world.origin_e) @ world.C_e_S.T
    P_e = track.P[:, X.dr_e, X.dr_e]
    covariance = np.einsum('ij,njk,lk->nil', world.C_e_S, P_e, world.C_e_S)
    velocity_b = np.einsum('nji,nj->ni', track.C_b_G, track.v_G)
    true_b = np.einsum('nji,nj->ni', run.true_C_b_G[row], run.v[row])
    return BodyStates(
        run.t_s[row],
        position[:, :2],
        run.p[row, :2],
        velocity_b[:, :2],
        true_b[:, :2],
        covariance[:, :2, :2],
    )


def station_errors(
    world: StationWorld, states: BodyStates, receipts: Sequence[Receipt]
) -> StationErrors:
    """Errors of a run; estimate minus truth."""
    start_ns = world.run.start_ns
    judged = [r for r in receipts if np.isfinite(r.nis)]
    return StationErrors(
        time_s=states.time_s,
        position=states.position - states.true_position,
        velocity_b=states.velocity_b - states.true_velocity_b,
        covariance=states.covariance,
        fix_time_s=np.array([(f.validity_ns - start_ns) / NS for f in world.fix_positions]),
        fix=world.fix_errors(),
        nis_time_s=np.array([(r.validity_ns - start_ns) / NS for r in judged]),
        nis=np.array([r.nis for r in judged]),
    )


def _ratios(errors: StationErrors) -> dict[str, float]:
    """Largest error of the fixes over that of the estimate, after adaptation."""
    part = errors.window(*AFTER)
    if not (len(part.time_s) and len(part.fix)):
        return {}
    ratio = np.abs(part.fix).max(axis=0) / np.abs(part.position).max(axis=0)
    return {f'ratio_{axis}': float(ratio[i]) for i, axis in enumerate(AXES)}


def _identified(
    world: StationWorld, result: engine_run.Result[engine_run.StationTrack], params: EngineParams
) -> dict[str, float]:
    """Metrics of the first identified drag and current, or of the filter's estimate at that time.

    The error of the current is against its mean until then; ``adapted``: whether the filter used
    the identified parameters.
    """
    names = ('drag_linear', 'drag_quadratic', 'current_x', 'current_y')
    if result.identifications:
        first = result.identifications[0]
        found = dict(zip(first.names, first.values, strict=True))
        values = [float(found[name]) for name in names]
        adapted = {'adapted': float(first.verdict is IdentificationVerdict.ACCEPTED)}
    else:
        time_s = (result.track.stamps_ns - world.run.start_ns) / NS
        late = np.flatnonzero(time_s >= ADAPTED_S)
        if not len(late):
            return {}
        model = result.track.model(int(late[0]), params)
        values = [model.drag_linear, model.drag_quadratic, *model.current_G[:2].tolist()]
        adapted = {}
    true = world.run.current[world.run.t_s <= ADAPTED_S, :2].mean(axis=0)
    error = float(np.hypot(*(np.array(values[2:]) - true)))
    return {**dict(zip(names, values, strict=True)), 'current_error': error, **adapted}


def _series(world: StationWorld, s: BodyStates, e: StationErrors) -> dict[str, Array]:
    """Estimates, truth and errors over time, thinned; and the fixes."""
    stride = max(1, round(_SERIES_S / max(1e-3, float(np.median(np.diff(s.time_s))))))
    sigma = np.sqrt(np.diagonal(s.covariance, axis1=1, axis2=2))
    out = {'time_s': s.time_s[::stride], 'fix_time_s': e.fix_time_s}
    for i, axis in enumerate(AXES):
        rows = {
            axis: s.position,
            f'true_{axis}': s.true_position,
            f'error_{axis}': e.position,
            f'sigma_{axis}': sigma,
            f'v{axis}': s.velocity_b,
            f'true_v{axis}': s.true_velocity_b,
            f'error_v{axis}': e.velocity_b,
        }
        out |= {key: np.asarray(values[::stride, i]) for key, values in rows.items()}
        out[f'fix_error_{axis}'] = e.fix[:, i]
        out[f'fix_{axis}'] = np.array([getattr(f, axis) for f in world.fix_positions])
    return out


def _tracks(world: StationWorld, found: Sequence[Identification]) -> dict[str, Array]:
    """Track of the paper's model, Eq. 16, over the window of the first identification."""
    published = [i for i in found if i.method == 'published']
    if not published:
        return {}
    first = published[0]
    fixes = [f for f in world.fix_positions if f.validity_ns <= first.last_validity_ns]
    psi, pitch = heading_and_pitch(world.run.C_b_G[::_LOG_EVERY])
    stamps = world.inputs.imu_stamps_ns[::_LOG_EVERY]
    log = Log(
        stamps,
        psi,
        pitch,
        world.run.omega_ib_b[::_LOG_EVERY, 2],
        stamps,
        world.run.force_b[::_LOG_EVERY, 0],
    )
    window = make_window(fixes, log, most=first.fixes, longest_gap_s=_GAP_S)
    if window is None:
        return {}
    samples = Samples.of(window)
    model = world.params(StationChoices(), 0.0).vehicle_model()
    before = np.array([model.drag_linear[0], model.drag_quadratic[0], 0.0, 0.0])
    out: dict[str, Array] = {}
    for which, values in (('before', before), ('after', first.values[:4])):
        track, _ = track_and_slopes(samples, values)
        for i, axis in enumerate(AXES):
            out[f'model_{which}_{axis}'] = track[:, i]
            out[f'window_{axis}'] = window.position[:, i]
    return out
