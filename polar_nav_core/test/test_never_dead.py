"""No sequence of messages stops navigation: whatever came, good samples give estimates again."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import DepthSample, DvlPing, Fix, ImuSample
from polar_nav_core.engine.outputs import Estimate
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.reorder import Reorder

START_NS = 1_772_323_200_000_000_000
R_E = np.array([1.0e6, -5.0e5, 6.25e6])
GRAVITY_B = np.array([0.0, 0.0, 9.83])
NUMBERS = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, 1.0, -1.0, 9.8, 50.0, 5e-324, 1e160, 1e300, -1e308]),
)
LEAPS_NS = st.sampled_from(
    [0, 1, 10**7, 10**8, 10**9, 5 * 10**9, -(10**9), 36 * 10**11, 4 * 10**17]
)
THREE = st.lists(NUMBERS, min_size=3, max_size=3).map(np.array)
NINE = st.lists(NUMBERS, min_size=9, max_size=9).map(lambda v: np.array(v).reshape(3, 3))
KINDS = st.sampled_from(['imu', 'dvl', 'depth', 'fix'])
CHOICES = st.sampled_from(['default', 'modified_akf', 'conventional_akf'])


def noisy(now_ns):
    """Gravity with some noise: a sensor that repeats itself hangs."""
    return GRAVITY_B + 1e-12 * (now_ns // 10**7 % 2)


def message(draw, number, now_ns):
    """Any message: kind, stamp and numbers as drawn."""
    stamp_ns = max(1, now_ns + draw(LEAPS_NS))
    kind = draw(KINDS)
    if kind == 'imu':
        return ImuSample(stamp_ns, number, draw(THREE), draw(THREE))
    if kind == 'dvl':
        return DvlPing(stamp_ns, number, True, draw(THREE), draw(NINE))
    if kind == 'depth':
        return DepthSample(stamp_ns, number, draw(NUMBERS), draw(NUMBERS))
    good = draw(st.booleans())
    r_e = R_E + 1e3 * number if good else draw(THREE)
    return Fix(
        stamp_ns, stamp_ns, stamp_ns, 'leader', number, number, number, r_e, draw(NINE),
        array_heading=draw(NUMBERS), relative_e=draw(THREE),
    )  # fmt: skip


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_no_messages_stop_navigation(data):
    engine = Engine(EngineParams(configuration=data.draw(CHOICES)))
    reorder = Reorder(engine, 0.05, 0.25)
    now_ns = START_NS

    def rest(samples):
        nonlocal now_ns
        out = []
        for _ in range(samples):
            now_ns += 10**7
            out += reorder.add(ImuSample(now_ns, now_ns, np.zeros(3), noisy(now_ns)))
        return [o for o in out if isinstance(o, Estimate)]

    assert rest(30)
    for number in range(data.draw(st.integers(1, 12))):
        list(reorder.add(message(data.draw, number, now_ns)))
        rest(data.draw(st.integers(0, 3)))
    now_ns = max(now_ns, engine.last_imu_ns or 0)  # a clock that leapt with two agrees
    estimates = rest(200)
    assert engine.navigating
    assert len(estimates) > 15
    assert all(np.isfinite(e.r_e).all() and np.isfinite(e.P).all() for e in estimates)
