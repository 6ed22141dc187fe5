"""The work of a late fix stepped again with Stone Soup: predictions and updates, one by one.

The matrices are those that the engine stored while it fused the same fix on time: transitions and
variances of its covariance steps, rows, noise and innovations of its updates (DVL at 5 Hz, depth
at 10 Hz, the fix). `rewind` also integrates the IMU again and linearizes anew; Stone Soup is
handed the matrices and does neither.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import partial

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Event
from polar_nav_core.errors import PolarNavError
from polar_nav_core.kernels.sins import rings

from .covariance import difference
from .late_fixes import Prepared, aged, before, drive, engine_of, simulated, taken_over
from .navigation import Disagreement
from .rounds import Entry

AGE_S = 9.95
"""100 covariance steps. The fix stands between two measurements: among those of one stamp the
stored position would be moved to its place to first order only."""
_OFFSET_S = 0.05
BOUND = 1e-9
"""Largest difference of covariances and means, relative to the standard deviations."""

_USBL_SIGMA = 0.5
"""The USBL bias is estimated, so that all 24 states are in use [m]."""
_START = datetime(2026, 1, 1)
_STEP = timedelta(seconds=0.1)


@dataclass(frozen=True)
class Update:
    """Rows of one update.

    Attributes
    ----------
    H, R : (m, 24), (m, m) arrays
    y : (m,) array
        Innovation without feedback [SI].
    """

    H: Array
    R: Array
    y: Array


@dataclass(frozen=True)
class Step:
    """One prediction; then its updates.

    Attributes
    ----------
    Phi, Q : (24, 24) arrays
    updates : tuple of Update
    """

    Phi: Array
    Q: Array
    updates: tuple[Update, ...]


@dataclass(frozen=True)
class Stored:
    """Steps that the engine stored from a fix on, and their result.

    Attributes
    ----------
    P : (24, 24) array
        Covariance before the fix.
    fix : Update
    steps : tuple of Step
    P_end, x_end : (24, 24), (24,) arrays
        Covariance, and the sum of the fed-back errors, at the end.
    """

    P: Array
    fix: Update
    steps: tuple[Step, ...]
    P_end: Array
    x_end: Array


@dataclass(frozen=True)
class Work:
    """A late fix in prepared engines, and the same work as matrices."""

    engines: dict[str, Prepared]
    take: Callable[[str], object]
    stored: Stored


def work(filled_s: float, age_s: float = AGE_S) -> Work:
    """Work of one late fix: simulated, with prepared engines and stored matrices.

    Parameters
    ----------
    filled_s : float
        Length of the run before the fix is received [s].
    age_s : float
        Age of the fix then [s].
    """
    world = simulated(filled_s, first_s=_OFFSET_S)
    fix = aged(world, age_s)
    events = before(world)
    engines = {
        name: Prepared(engine_of(world, name, usbl_bias_sigma=_USBL_SIGMA), events)
        for name in ('clone', 'rewind')
    }
    on_time = replace(fix, transmit_ns=fix.validity_ns, receive_ns=fix.validity_ns)
    until = [event for event in events if event.key < on_time.key]
    rest = [on_time, *events[len(until) :]]
    engine = engine_of(world, 'clone', usbl_bias_sigma=_USBL_SIGMA)
    drive(engine, until)
    return Work(engines, lambda name: engines[name].take(fix), _stored(engine, rest))


def _stored(engine: Engine, rest: list[Event]) -> Stored:
    """Steps of the fix and of all later events, read from the log of linear steps."""
    fusion = taken_over(engine)
    if fusion is None:
        raise PolarNavError(f'the engine has no state: {engine.divergence}')
    f, w = fusion.filter, fusion.filter.work
    P0, first = f.state.P.copy(), int(f.log.counts[0])
    drive(engine, rest[:1])
    fix, x, P = Update(w.H.copy(), w.R.copy(), w.z.copy()), w.x.copy(), f.state.P.copy()
    if not x.any():
        raise PolarNavError('the engine did not fuse the fix that was on time')
    drive(engine, rest[1:])
    log, Q = f.log, np.diag(f.work.q)  # of each step: all are of one length
    found: list[tuple[Array, Array, list[Update]]] = []
    for entry in range(first, int(log.counts[0])):
        e = entry % len(log.kinds)
        number = int(log.numbers[e])
        if log.kinds[e] == rings.STEP:
            Phi = f.past.transitions[number % len(f.past.transitions)].copy()
            found.append((Phi, Q, []))
            x, P = Phi @ x, log.step_P[number % len(log.step_P)].copy()
            continue
        u = number % len(log.H)
        m = int(log.rows[e])
        H, K, S = log.H[u, :m].copy(), log.K[u, :m], log.S[u, :m, :m]
        found[-1][2].append(Update(H, S - H @ P @ H.T, log.z[u, :m] + H @ x))
        x, P = x + log.x[u], P - K.T @ S @ K
    steps = tuple(Step(Phi, Q, tuple(updates)) for Phi, Q, updates in found)
    return Stored(P0, fix, steps, f.state.P.copy(), x)


class StoneSoup:
    """`KalmanPredictor` and `KalmanUpdater` of Stone Soup over the stored matrices.

    All models and measurements are prepared; only prediction and update run.

    Raises
    ------
    PolarNavError
        When Stone Soup is not installed.
    """

    def __init__(self, stored: Stored) -> None:
        try:
            from stonesoup.models.measurement.linear import LinearGaussian
            from stonesoup.models.transition.linear import (
                LinearGaussianTimeInvariantTransitionModel,
            )
            from stonesoup.predictor.kalman import KalmanPredictor
            from stonesoup.types.detection import Detection
            from stonesoup.types.hypothesis import SingleHypothesis
            from stonesoup.types.prediction import GaussianStatePrediction
            from stonesoup.updater.kalman import KalmanUpdater
        except ImportError as error:
            raise PolarNavError(
                f'{error.name} is not installed: the benchmarks need all of requirements.lock'
            ) from error
        n = len(stored.P)

        class Rows(LinearGaussian):  # type: ignore[misc] # the library carries no types
            """Any matrix as rows; the library's own select states."""

            rows = np.zeros((0, n))

            def matrix(self, **_: object) -> Array:
                return self.rows

        def detection(update: Update, time: datetime) -> object:
            model = Rows(ndim_state=n, mapping=range(len(update.H)), noise_covar=update.R)
            model.rows = update.H
            return Detection(update.y, timestamp=time, measurement_model=model)

        self._hypothesis = SingleHypothesis
        self._updater = KalmanUpdater(None)
        self._prior = partial(GaussianStatePrediction, np.zeros(n), stored.P, timestamp=_START)
        self._fix = detection(stored.fix, _START)
        self._steps = []
        for k, step in enumerate(stored.steps, start=1):
            time = _START + k * _STEP
            model = LinearGaussianTimeInvariantTransitionModel(
                transition_matrix=step.Phi, covariance_matrix=step.Q
            )
            updates = [detection(update, time) for update in step.updates]
            self._steps.append((KalmanPredictor(model), time, updates))

    def run(self) -> tuple[Array, Array]:
        """Mean and covariance after all steps."""
        updater, hypothesis = self._updater, self._hypothesis
        # A new prior each time: predictors remember what they predicted from the same object.
        state = updater.update(hypothesis(self._prior(), self._fix))
        for predictor, time, detections in self._steps:
            state = predictor.predict(state, timestamp=time)
            for detection in detections:
                state = updater.update(hypothesis(state, detection))
        return np.asarray(state.state_vector).ravel(), np.asarray(state.covar)


def agreement(w: Work, peer: StoneSoup) -> dict[str, float]:
    """Differences of covariance and mean at the end, relative to the standard deviations.

    Raises
    ------
    Disagreement
        If a difference is over BOUND.
    """
    sigma = np.sqrt(np.diagonal(w.stored.P_end))
    mean, P = peer.run()
    w.take('rewind')
    fusion = taken_over(w.engines['rewind'].engine)
    if fusion is None:
        raise Disagreement('rewind: the filter stopped')
    found = {
        'covariance: the engine, fix on time': difference(w.stored.P_end, P),
        'covariance: rewind, fix late': difference(fusion.filter.state.P, P),
        'mean: the engine, fix on time': float(np.max(np.abs(w.stored.x_end - mean) / sigma)),
    }
    w.engines['rewind'].restore()
    for name, value in found.items():
        if not value <= BOUND:
            raise Disagreement(f'{name}: differs from Stone Soup by {value:.3g}, over {BOUND}')
    return found


def entries(w: Work, peer: StoneSoup) -> list[Entry]:
    """Entries of the late fix by `clone` and `rewind`, and of its work stepped with Stone Soup."""
    ours = [
        Entry(name, f'{name}, the fix in the engine', 1, partial(w.take, name), one.restore)
        for name, one in w.engines.items()
    ]
    return [*ours, Entry('stone_soup', 'Stone Soup, stepped', 1, peer.run)]
