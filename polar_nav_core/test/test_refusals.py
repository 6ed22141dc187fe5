"""What is usable by columns is what is usable event by event."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_core.engine import refusals
from polar_nav_core.engine.events import ControlSample, DepthSample, DvlPing, ImuSample
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.repeated import Repeated

SINS = EngineParams()
STATION = EngineParams(mode='station', configuration='default')
NUMBERS = st.sampled_from(
    [0.0, 1.0, -1.0, 0.5, 5e-324, 30.0, 1e6, 1e300, -1e308, np.nan, np.inf, -np.inf]
)


def columns(draw, n, *shape):
    """Mostly good numbers, so that rows that are good altogether occur."""
    values = np.ones((n, *shape))
    for _ in range(draw(st.integers(0, 4)) if n else 0):
        values.reshape(-1)[draw(st.integers(0, values.size - 1))] = draw(NUMBERS)
    return values


def matrices(draw, n):
    """Mostly unit matrices with a few other numbers, some on both sides of the diagonal."""
    values = np.tile(np.eye(3), (n, 1, 1))
    for _ in range(draw(st.integers(0, 4)) if n else 0):
        k, i, j = (draw(st.integers(0, m - 1)) for m in (n, 3, 3))
        values[k, i, j] = draw(NUMBERS)
        if draw(st.booleans()):
            values[k, j, i] = values[k, i, j]
    return values


def one_by_one(params, events):
    """Scalar form, with the stamp of the last usable IMU sample as the engine keeps it."""
    usable, last_ns, repeated = [], None, Repeated(params)
    for event in events:
        good = refusals.unusable_local(params, event, last_ns) is None
        if good and isinstance(event, ImuSample):
            good = repeated.refusal(event) is None
        usable.append(good)
        if good:
            last_ns = event.stamp_ns
    return usable


@given(st.data())
def test_imu(data):
    n = data.draw(st.integers(0, 20))
    stamps = np.cumsum([0, *data.draw(st.lists(st.integers(0, 1), min_size=n, max_size=n))])[1:]
    omega_ib_b, f_b = (columns(data.draw, n, 3) for _ in range(2))
    C_b_G = matrices(data.draw, n)
    samples = [ImuSample(int(stamps[k]), k, omega_ib_b[k], f_b[k]) for k in range(n)]
    usable, repeats = refusals.usable_imu(SINS, stamps, omega_ib_b, f_b)
    assert usable.tolist() == one_by_one(SINS, samples)
    assert not usable[repeats > 0].any()
    samples = [
        ImuSample(int(stamps[k]), k, omega_ib_b[k], np.zeros(3), C_b_G[k]) for k in range(n)
    ]
    usable, repeats = refusals.usable_imu(STATION, stamps, omega_ib_b, C_b_G)
    assert usable.tolist() == one_by_one(STATION, samples)
    assert not repeats.any()


@given(st.data())
def test_dvl(data):
    n = data.draw(st.integers(0, 8))
    valid = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)), dtype=bool)
    v_m, covariance_m = columns(data.draw, n, 3), matrices(data.draw, n)
    pings = [DvlPing(k, k, bool(valid[k]), v_m[k], covariance_m[k]) for k in range(n)]
    assert refusals.usable_dvl(SINS, valid, v_m, covariance_m).tolist() == one_by_one(SINS, pings)


@given(st.data())
def test_depth(data):
    n = data.draw(st.integers(0, 8))
    depth, variance = columns(data.draw, n), columns(data.draw, n)
    samples = [DepthSample(k, k, float(depth[k]), float(variance[k])) for k in range(n)]
    assert refusals.usable_depth(SINS, depth, variance).tolist() == one_by_one(SINS, samples)


@given(st.data())
def test_control(data):
    n = data.draw(st.integers(0, 8))
    force_b, torque_b = columns(data.draw, n, 3), columns(data.draw, n, 3)
    samples = [ControlSample(k, k, force_b[k], torque_b[k]) for k in range(n)]
    assert refusals.usable_control(SINS, force_b, torque_b).tolist() == one_by_one(SINS, samples)
    samples = [ControlSample(k, k, force_b[k], np.zeros(3)) for k in range(n)]
    assert refusals.usable_control(SINS, force_b).tolist() == one_by_one(SINS, samples)


def test_an_imu_that_hangs_is_refused_after_five_repeats():
    values = [np.full(3, 0.1)] * 9 + [np.full(3, 0.2)] * 6
    samples = [ImuSample(k, k, v, v) for k, v in enumerate(values)]
    found = one_by_one(SINS, samples)
    assert found == [True] * 6 + [False] * 3 + [True] * 6
    _, repeats = refusals.usable_imu(SINS, np.arange(15), np.array(values), np.array(values))
    assert repeats.tolist() == [0] * 6 + [6, 7, 8] + [0] * 6
    never = EngineParams(max_imu_repeats=0)
    assert all(one_by_one(never, samples))
