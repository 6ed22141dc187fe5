"""Late fixes of a station: the exact strategies are exact, the others are what they say."""

from dataclasses import replace
from functools import cache

import numba
import numpy as np
import pytest
import station_oracle as oracle
import station_twin as twin
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import DepthSample, Fix, ImuSample
from polar_nav_core.engine.methods import DELAY_HANDLING
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.kernels.station import (
    attitude as station_attitude,
)
from polar_nav_core.kernels.station import (
    forward as station_forward,
)
from polar_nav_core.kernels.station import (
    run as station_run,
)
from polar_nav_core.kernels.station import state as ss
from polar_nav_core.kernels.vehicle import model as vehicle_model
from polar_nav_core.warm import warm_station

SECONDS = 20.0
QUIET = {
    'configuration': 'custom',
    'gate_probability': 1.0,
    'robust_fixes': 'none',
    'identify_method': 'none',
}


@cache
def world():
    return twin.inputs(twin.truth(SECONDS), 4, depth_every=10)


@cache
def noted():
    """Fixes once a second, so that several are on their way."""
    fixes = world().fixes
    truth = twin.truth(SECONDS)
    rng = np.random.default_rng(8)
    result = []
    for n in range(14):
        t = 1.003 + n
        p = twin.interpolated(truth, t)
        polar = replace(
            fixes[0].polar,
            range=float(np.linalg.norm(p)) + rng.normal() * 3.0,
            bearing=float(np.arctan2(p[1], p[0])) - twin.STATION_PSI + rng.normal() * 0.01,
        )
        now = twin.START_NS + round(t * 1e9)
        result.append(
            replace(
                fixes[0], validity_ns=now, transmit_ns=now, receive_ns=now, sequence=n, order=n,
                arrival=n, polar=polar,
            )
        )  # fmt: skip
    return tuple(result)


def delayed(delays):
    return tuple(
        replace(f, receive_ns=f.validity_ns + round(d * 1e9))
        for f, d in zip(noted(), delays, strict=True)
    )


def run(name, fixes, one_by_one=False, **changes):
    params = twin.params(**{**QUIET, 'delay_handling': name, **changes})
    return engine_run.run(params, replace(world(), fixes=fixes), one_by_one=one_by_one)


def last(result):
    t = result.track
    return t.x[-1], t.P_x[-1]


@cache
def in_order():
    return run('rewind', noted())


delays = st.lists(st.floats(0.0, 5.0), min_size=14, max_size=14)


@settings(max_examples=8, deadline=None)
@given(delays)
def test_rewind_is_bit_identical_to_the_order_of_validity(values):
    """Whatever the order of arrival: state, covariance, weights of the bank."""
    late = run('rewind', delayed(values))
    assert np.array_equal(late.track.x[-1], in_order().track.x[-1])
    assert np.array_equal(late.track.P_x[-1], in_order().track.P_x[-1])
    assert np.array_equal(late.track.weight[-1], in_order().track.weight[-1])


def test_a_fix_that_makes_no_difference_would_be_noticed():
    fewer = run('rewind', noted()[:-1])
    assert not np.array_equal(fewer.track.x[-1], in_order().track.x[-1])


LATE = (2.6, 0.4, 3.5, 1.7, 0.0, 4.9, 2.2, 1.1, 3.3, 0.6, 2.9, 1.4, 4.0, 0.2)


@pytest.mark.parametrize('name', ['rewind', 'clone', 'back_propagate', 'tagged', 'ignore'])
def test_a_whole_run_gives_the_bits_of_event_by_event(name):
    a = run(name, delayed(LATE))
    b = run(name, delayed(LATE), one_by_one=True)
    for field in engine_run.StationTrack.__dataclass_fields__:
        x, y = getattr(a.track, field), getattr(b.track, field)
        assert x.shape == y.shape
        assert np.array_equal(x, y, equal_nan=True), field
    assert [str(r) for r in a.receipts] == [str(r) for r in b.receipts]
    assert a.verdicts == b.verdicts


@pytest.mark.parametrize('name', ['clone', 'back_propagate', 'tagged'])
def test_strategies_that_know_the_delay_are_near_the_exact_one(name):
    exact = run('rewind', delayed(LATE))
    other = run(name, delayed(LATE))
    ignorant = run('ignore', delayed(LATE))
    x, P = last(exact)
    sigma = np.sqrt(np.diagonal(P))[:11]
    off = np.abs(last(other)[0] - x)[:11] / sigma
    blind = np.abs(last(ignorant)[0] - x)[:11] / sigma
    assert off.max() < (0.15 if name == 'clone' else 0.5)
    assert blind.max() > 1.5 * off.max()


@pytest.mark.parametrize(
    'fix_delays',
    [
        pytest.param(LATE, id='overlapping', marks=pytest.mark.slow),
        pytest.param((1.5,) * 14, id='equal', marks=pytest.mark.slow),
    ],
)
def test_clone_equals_an_explicitly_augmented_filter(fix_delays):
    """The same linear steps, with a clone of the state for each fix on its way."""
    params = twin.params(
        **{**QUIET, 'delay_handling': 'clone', 'current_method': 'single', 'history_s': 60.0}
    )
    fixes = delayed(fix_delays)
    engine, inputs = Engine(params), replace(world(), fixes=fixes)
    steps, at_fix = [], {}
    for event in inputs.events():
        list(engine.process(event))
        f = engine.fusion.filter
        if isinstance(event, ImuSample):  # where the step was linearised when it first was taken
            steps.append(f.log.points[len(steps), 0].copy())
        elif isinstance(event, Fix):
            place = np.flatnonzero(f.streams.fix_stamps == event.validity_ns)[0]
            at_fix[event.validity_ns] = f.streams.fix_points[place, 0].copy()
    x, P = explicitly_augmented(f, inputs, fixes, steps, at_fix)
    actual, spread = f.bank.x[0], f.bank.P[0]
    sigma = np.sqrt(np.diagonal(P))[:11]
    assert (np.abs(actual - x)[:11] <= 1e-7 * sigma).all()
    assert (np.abs(spread - P)[:11, :11] <= 1e-9 * np.outer(sigma, sigma)).all()


def explicitly_augmented(f, inputs, fixes, points, at_fix):
    """Kalman filter on [state, clones], linearised at the given points.

    Start, settings and smoothed attitudes are all that is taken from the filter.
    """
    c, s = f.settings, f.streams
    x, P = f.log.x[0, 0].copy(), f.log.P[0, 0].copy()
    rows = {fix.validity_ns: k for k, fix in enumerate(sorted(fixes, key=lambda f: f.validity_ns))}
    clones: list[int] = []
    force = np.zeros(3)
    events = sorted(
        [
            *((e.key, e) for e in inputs.events()),
            *(((fix.validity_ns, 4, fix.order, -1), fix) for fix in fixes),
        ],
        key=lambda pair: pair[0],
    )
    k, now = 0, twin.START_NS
    for key, e in events:
        if isinstance(e, ImuSample):
            if k:
                at, h = points[k], (e.stamp_ns - now) * 1e-9
                up, height, C_G_A = oracle.place(at[3:6], c)
                mid = 0.5 * (s.C_b_G[k - 1] + s.C_b_G[k])
                C_A = C_G_A @ mid
                omega = e.omega_ib_b - C_A.T @ c.omega_ie_A
                F = np.eye(12) + h * oracle.slopes(at, C_A, omega, c)
                moved = at + h * oracle.rates(at, C_A, omega, mid[2], force, c)
                x[:12] = moved + F @ (x[:12] - at)
                P[:12] = F @ P[:12]
                P[:, :12] = P[:, :12] @ F.T
                P[:12, :12] += np.diag(oracle.added(c, h, c.q_current[0]))
                geometry = up, height, at[3:6].copy()
            k, now = k + 1, e.stamp_ns
        elif isinstance(e, DepthSample):
            if k == 1:
                up, height, _ = oracle.place(x[3:6], c)
                geometry = up, height, x[3:6].copy()
            up, height, place = geometry
            H = np.zeros((1, len(x)))
            H[0, 3:6] = up
            z = c.surface - e.depth - height - up @ (x[3:6] - place)
            x, P = updated(x, P, H, np.array([z]), np.array([[e.variance]]))
        elif isinstance(e, Fix) and key[3] == -1:
            clones.append(e.validity_ns)
            keep = np.vstack([np.eye(len(x)), np.eye(12, len(x))])
            x, P = keep @ x, keep @ P @ keep.T
        elif isinstance(e, Fix):
            i = rows[e.validity_ns]
            at, fix = at_fix[e.validity_ns], s.fixes[i]
            epoch = int(np.searchsorted(inputs.imu_stamps_ns, e.validity_ns, side='right')) - 1
            _, _, C_G_A = oracle.place(points[epoch][3:6], c)
            C_A, dt = C_G_A @ s.C_b_G[epoch], (e.validity_ns - inputs.imu_stamps_ns[epoch]) * 1e-9
            j = 12 * (1 + clones.index(e.validity_ns))
            H = np.zeros((2, len(x)))
            H[:, j : j + 12] = oracle.fix_slopes(at, C_A, fix, dt)
            z = fix[[ss.RANGE, ss.BEARING]] - oracle.range_and_bearing(at, C_A, fix, dt)
            z[1] = np.remainder(z[1] + np.pi, 2 * np.pi) - np.pi
            z -= H[:, j : j + 12] @ (x[j : j + 12] - at)
            R = np.diag(fix[[ss.RANGE_VARIANCE, ss.BEARING_VARIANCE]])
            x, P = updated(x, P, H, z, R)
        elif hasattr(e, 'force_b'):
            force = e.force_b
    return x[:12], P[:12, :12]


def updated(x, P, H, z, R):
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    return x + K @ z, P - K @ S @ K.T


def outputs(params, events):
    engine = Engine(params)
    found = [output for event in events for output in engine.process(event)]
    return (
        engine,
        [o for o in found if isinstance(o, Receipt)],
        [o for o in found if isinstance(o, Estimate)],
    )


def test_older_than_the_history_is_refused_with_its_reach():
    late = list(noted())
    late[2] = replace(late[2], receive_ns=late[2].validity_ns + 9_000_000_000)
    for name in ('rewind', 'clone', 'tagged', 'back_propagate'):
        params = twin.params(**{**QUIET, 'delay_handling': name, 'max_delay_s': 5.0})
        _, receipts, _ = outputs(params, replace(world(), fixes=tuple(late)).events())
        verdicts = {r.sequence: r.verdict for r in receipts}
        assert verdicts.pop(2) is Verdict.TOO_OLD
        assert set(verdicts.values()) == {Verdict.FUSED}


def test_an_outlier_is_gated_and_one_that_is_decided_anew_says_so():
    fixes = list(noted())
    wild = fixes[6].polar
    fixes[6] = replace(fixes[6], polar=replace(wild, range=wild.range + 400.0))
    changes = {'gate_probability': 0.9999, 'robust_fixes': 'mahalanobis'}
    result = run('rewind', tuple(fixes), **changes)
    verdicts = {r.sequence: r.verdict for r in result.receipts}
    assert verdicts.pop(6) is Verdict.GATED
    assert set(verdicts.values()) == {Verdict.FUSED}


def test_innovations_are_metres_on_grid_axes():
    fixes = list(noted())
    result = run('rewind', tuple(fixes))
    far = fixes[-1].polar
    fixes[-1] = replace(fixes[-1], polar=replace(far, range=far.range + 10.0))
    shifted = run('rewind', tuple(fixes))
    change = shifted.receipts[-1].innovation_G - result.receipts[-1].innovation_G
    p = twin.interpolated(twin.truth(SECONDS), 14.003)
    along = np.array([p[0], p[1], 0.0]) / np.hypot(p[0], p[1])
    np.testing.assert_allclose(change, 10.0 * along, atol=0.3)
    assert np.isnan(result.receipts[-1].innovation_variance_G[2])
    assert result.receipts[-1].dof == 2


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_set_up_compiles_every_kernel_that_station_mode_calls():
    warm_station()
    before = signatures()
    assert sum(before.values()) >= 7
    for name in DELAY_HANDLING:
        run(name, delayed(LATE))
        run(name, delayed(LATE), one_by_one=True)
    changes = {**QUIET, 'delay_handling': 'tagged', 'station_filter': 'published'}
    engine_run.run(twin.params(**changes), replace(world(), fixes=noted()))
    assert signatures() == before


def signatures():
    entries = (
        station_run.advance,
        station_run.put_row,
        station_run.restore,
        station_run.start,
        station_forward.forward_fix,
        station_attitude.smooth,
        vehicle_model.surge_drag,
    )
    return {f'{k.__module__}.{k.__name__}': len(k.signatures) for k in entries}
