"""Strapdown: kernels against NumPy twins, blocks, order of convergence, standstill, errors."""

import core_twin as twin
import numba
import numpy as np
import pytest
from core_oracle import Trajectory
from core_places import PLACES, STATES, position

from polar_nav_core import attitude, earth, grid
from polar_nav_core.kernels.frames import blocks, body, navigation, strapdown
from polar_nav_core.strapdown import Strapdown, increments

JIT = not numba.config.DISABLE_JIT
C_B_G = attitude.matrix_from_euler(2.0, 0.1, -0.2)
V_G = np.array([2.0, -3.0, 0.1])
ZERO = np.zeros(3)


def start(name='80N 120E'):
    return C_B_G.copy(), V_G.copy(), position(name)


def signal(n, seed=0, size=2e-3):
    """Increments of a lively vehicle: (n, 3) each."""
    rng = np.random.default_rng(seed)
    dtheta = size * np.cumsum(rng.normal(size=(n, 3)), axis=0) / np.sqrt(n)
    return dtheta, 1e-3 * rng.normal(size=(n, 3)) + [0.0, 0.0, 0.0983]


@pytest.mark.parametrize('name', PLACES)
def test_steps_equal_the_plain_twin(name):
    C, v, r = start(name)
    state = C.copy(), v.copy(), r.copy()
    dtheta, dvel = signal(50)
    previous = ZERO, ZERO
    for a, f in zip(dtheta, dvel, strict=True):
        strapdown.strapdown_step(C, v, r, a, f, *previous, 0.01)
        state = twin.step(*state, a, f, *previous, 0.01)
        previous = a, f
    np.testing.assert_allclose(C, state[0], rtol=0.0, atol=2e-14)
    np.testing.assert_allclose(v, state[1], rtol=0.0, atol=2e-13)
    np.testing.assert_allclose(r, state[2], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize('name', PLACES)
def test_rates_of_change_are_those_of_the_equations(name):
    """Central difference over one short step forward and one back."""
    w_b, f_b = np.array([0.01, -0.02, 0.03]), np.array([-0.7, 0.4, 9.8])
    dt = 1e-3
    states = []
    for h in (dt, -dt):
        C, v, r = start(name)
        strapdown.strapdown_step(C, v, r, w_b * h, f_b * h, w_b * h, f_b * h, h)
        states.append((C, v, r))
    expected = twin.derivatives(*start(name), w_b, f_b)
    for one, other, value, atol in zip(*states, expected, (1e-10, 1e-8, 1e-6), strict=True):
        np.testing.assert_allclose((one - other) / (2 * dt), value, rtol=0.0, atol=atol)


@pytest.mark.parametrize('name', STATES)
def test_reference_vectors(name):
    state, expected = STATES[name]['input'], STATES[name]['expected']
    arguments = [np.array(state[key]) for key in ('C_b_G', 'V_G', 'R_e', 'w_ib_b', 'f_b')]
    for found, key, atol in zip(
        twin.derivatives(*arguments),
        ('C_b_G_dot', 'V_G_dot', 'R_e_dot'),
        (1e-14, 1e-13, 1e-13),
        strict=True,
    ):
        np.testing.assert_allclose(found, expected[key], rtol=0.0, atol=atol)


def test_batch_and_blocks_of_one_give_the_bits_of_steps():
    dtheta, dvel = signal(200)
    results = []
    C, v, r = start()
    previous = ZERO, ZERO
    for a, f in zip(dtheta, dvel, strict=True):
        strapdown.strapdown_step(C, v, r, a, f, *previous, 0.01)
        previous = a, f
    results.append((C, v, r))
    for function, extra in (
        (strapdown.strapdown_batch, ()),
        (blocks.strapdown_blocks, (1,)),
    ):
        C, v, r = start()
        prev = np.zeros(3), np.zeros(3)
        function(C, v, r, dtheta[:77], dvel[:77], *prev, 0.01, *extra)
        function(C, v, r, dtheta[77:], dvel[77:], *prev, 0.01, *extra)
        np.testing.assert_array_equal(prev, [dtheta[-1], dvel[-1]])
        results.append((C, v, r))
    C, v, r = start()
    before = 0.0
    previous = ZERO, ZERO
    for a, f in zip(dtheta, dvel, strict=True):
        strapdown.strapdown_step_uneven(C, v, r, a, f, *previous, 0.01, before)
        previous, before = (a, f), 0.01
    np.testing.assert_allclose(r, results[0][2], rtol=0.0, atol=2e-8)
    for other in results[1:]:
        for one, two in zip(results[0], other, strict=True):
            np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize('name', ['exact north pole', '80N 120E', '75S 60W'])
def test_blocks_are_of_second_order_in_their_length(name):
    """A tumbling vehicle that falls 400 m in 10 s: hundred times what blocks are for."""
    dtheta, dvel = signal(1000 if JIT else 200)
    found = []
    for block in (1, 10, 20):
        C, v, r = start(name)
        blocks.strapdown_blocks(C, v, r, dtheta, dvel, np.zeros(3), np.zeros(3), 0.01, block)
        found.append((C, v, r))
    for i, (of_ten, order) in enumerate(((2e-12, None), (5e-7, 1.9), (5e-5, 1.9))):
        ten, twenty = (np.linalg.norm(found[k][i] - found[0][i]) for k in (1, 2))
        assert ten < of_ten
        if order is not None:
            assert np.log2(twenty / ten) > order


def final_error(dt, block=1, duration=60.0):
    """Position [m] and attitude [rad] error after a start in full swing, near the pole."""
    trajectory = Trajectory(-5.0, 2.0, 3.0, 1.0, growth=0.0)
    dtheta, dvel = trajectory.increments(duration, dt)
    before = trajectory.increments(dt, dt, begin=-dt)
    C_b_e, v_e, r_e = trajectory.start()
    C_e_G = grid.ecef_to_grid(r_e)
    C, v, r = C_e_G @ C_b_e, C_e_G @ v_e, r_e.copy()
    blocks.strapdown_blocks(
        C, v, r, dtheta, dvel, before[0][0].copy(), before[1][0].copy(), dt, block
    )
    end = [duration]
    true_r = trajectory.path(end)[0][0]
    C_e_G = grid.ecef_to_grid(true_r)
    turn = attitude.log(C @ (C_e_G @ trajectory.attitude(end)[0]).T)
    return np.linalg.norm(r - true_r), np.linalg.norm(turn)


@pytest.mark.parametrize('quantity', [0, 1], ids=['position', 'attitude'])
def test_error_falls_with_the_square_of_dt_or_faster(quantity):
    errors = [final_error(dt)[quantity] for dt in (0.16, 0.08, 0.04)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 1.9), orders


def test_truth_is_met_at_100_hz_and_in_blocks():
    position_error, attitude_error = final_error(0.01, duration=60.0 if JIT else 10.0)
    assert position_error < 2e-5
    assert attitude_error < 2e-9
    in_blocks = final_error(0.01, block=10, duration=60.0 if JIT else 10.0)
    assert in_blocks[0] < 2e-5
    assert in_blocks[1] < 2e-9


def test_first_step_without_a_previous_one_is_harmless():
    """Zeros for the previous increments: no compensation in the first step, nothing worse."""
    trajectory = Trajectory(-5.0, 2.0, 3.0, 1.0, growth=0.0)
    dtheta, dvel = trajectory.increments(0.01, 0.01)
    before = trajectory.increments(0.01, 0.01, begin=-0.01)
    found = []
    for prev in (before[0][0], before[1][0]), (ZERO, ZERO):
        C, v, r = start('exact north pole')
        strapdown.strapdown_step(C, v, r, dtheta[0], dvel[0], *prev, 0.01)
        found.append((C, v, r))
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=0.0, atol=1e-5)


def test_uneven_intervals():
    """Rate and force linear in time over two intervals: exact to that order."""

    def rate(t):
        return np.array([0.3 + 2.0 * t, -0.2 + 1.0 * t, 0.5 - 3.0 * t])

    def force(t):
        return np.array([1.0 - 20.0 * t, 2.0 + 10.0 * t, 9.8 + 30.0 * t])

    def integrals(a, b):
        # exact for linear functions
        return rate(0.5 * (a + b)) * (b - a), force(0.5 * (a + b)) * (b - a)

    dt = 0.02
    fine = 400
    C, v, r = start()
    h = dt / fine
    for k in range(fine):
        previous = integrals((k - 1) * h, k * h)
        strapdown.strapdown_step(C, v, r, *integrals(k * h, (k + 1) * h), *previous, h)
    for dt_prev in (0.005, 0.02, 0.05):
        C2, v2, r2 = start()
        strapdown.strapdown_step_uneven(
            C2, v2, r2, *integrals(0.0, dt), *integrals(-dt_prev, 0.0), dt, dt_prev
        )
        coned = np.linalg.norm(attitude.log(C2 @ C.T))
        sculled = np.linalg.norm(v2 - v)
        C3, v3, r3 = start()
        strapdown.strapdown_step_uneven(C3, v3, r3, *integrals(0.0, dt), ZERO, ZERO, dt, 0.0)
        assert coned < 0.01 * np.linalg.norm(attitude.log(C3 @ C.T))
        assert sculled < 0.02 * np.linalg.norm(v3 - v)
    assert body.coning_weight(dt, dt) == pytest.approx(1.0 / 12.0)
    assert body.coning_weight(dt, 0.0) == 0.0


@pytest.mark.parametrize('name', PLACES)
@pytest.mark.parametrize('dt_prev', [0.01, 0.004, 0.0])
def test_a_step_in_the_surroundings_of_its_own_middle_has_the_bits_of_a_step(name, dt_prev):
    dtheta, dvel = (np.array([[3e-3, -2e-3, 5e-3], [1e-3, 4e-3, -2e-3]]) for _ in range(2))
    dvel += [[0.02, -0.03, 0.098], [-0.01, 0.05, 0.099]]
    C, v, r = start(name)
    strapdown.strapdown_step_uneven(C, v, r, dtheta[1], dvel[1], dtheta[0], dvel[0], 0.01, dt_prev)
    held_C, held_v, held_r = start(name)
    held = np.array(navigation.surroundings(held_v, held_r, 0.005))
    rows = np.array([dtheta[1], dvel[1], dtheta[0], dvel[0]])
    strapdown.strapdown_step_held(held_C, held_v, held_r, rows, 0.01, dt_prev, held)
    np.testing.assert_array_equal(held_C, C)
    np.testing.assert_array_equal(held_v, v)
    np.testing.assert_array_equal(held_r, r)


@pytest.mark.parametrize('angle', [1e-9, 0.0499, 0.0501, 1.0, 3.0])
def test_rotation_coefficients_on_both_sides_of_the_series(angle):
    s, c, d = body.rotation_coefficients(angle * angle)
    assert s == pytest.approx(np.sin(angle / 2) / angle, rel=1e-15)
    assert c == pytest.approx(np.cos(angle / 2), rel=1e-15)
    series = 1 / 6 - angle**2 / 120 + angle**4 / 5040 - angle**6 / 362880
    assert d == pytest.approx(
        (angle - np.sin(angle)) / angle**3 if angle > 1 else series, rel=3e-2
    )
    if angle < 0.1:
        assert d == pytest.approx(series, rel=2e-12)


def test_attitude_stays_orthonormal():
    C, v, r = start()
    dtheta, dvel = signal(20_000 if JIT else 200, size=0.5)
    for _ in range(5):
        strapdown.strapdown_batch(C, v, r, dtheta, dvel, np.zeros(3), np.zeros(3), 0.01)
        v[:] = V_G
        r[:] = position('80N 120E')
    np.testing.assert_allclose(C @ C.T, np.eye(3), rtol=0.0, atol=1e-15)
    bent = C_B_G + 1e-6 * np.random.default_rng(1).normal(size=(3, 3))
    strapdown.strapdown_step(bent, v, r, ZERO, np.array([0, 0, 0.098]), ZERO, ZERO, 0.01)
    np.testing.assert_allclose(bent @ bent.T, np.eye(3), rtol=0.0, atol=3e-11)


@pytest.mark.parametrize(
    'place', [(89.99, 77.0, -100.0), (-89.99, 180.0, 0.0), (90.0, 0.0, 0.0), (60.0, -180.0, 0.0)]
)
def test_standstill_for_an_hour(place):
    lat, lon, h = place
    r_e = earth.ecef_from_geodetic(np.radians(lat), np.radians(lon), h)
    vehicle = Strapdown(C_B_G, ZERO, r_e)
    n = 360_000 if JIT else 500
    omega_b = C_B_G.T @ grid.earth_rate(r_e)
    f_b = C_B_G.T @ [0.0, 0.0, float(earth.gravity(r_e))]
    vehicle.run(np.tile(omega_b * 0.01, (n, 1)), np.tile(f_b * 0.01, (n, 1)), 0.01)
    moved_G = grid.ecef_to_grid(r_e) @ (vehicle.r_e - r_e)
    # rounding: the same last bits lost at each of 360 000 steps turn the vehicle by some 1e-12 rad
    assert np.max(np.abs(moved_G[:2])) < 2e-4
    # rounding, amplified 500 times by the unstable vertical channel
    assert abs(moved_G[2]) < 1e-4
    assert np.linalg.norm(attitude.log(vehicle.C_b_G @ C_B_G.T)) < 1e-10


def test_held_vertical_stays_where_it_is_put():
    dtheta, dvel = signal(100)
    height, v_up = np.linspace(-100.0, -90.0, 100), np.full(100, 0.1)
    C, v, r = start()
    strapdown.strapdown_batch_held(
        C, v, r, dtheta, dvel, np.zeros(3), np.zeros(3), 0.01, height, v_up
    )
    assert float(earth.geodetic_from_ecef(r)[2]) == pytest.approx(-90.0, abs=1e-8)
    assert v[2] == 0.1
    vehicle = Strapdown(C, v, r)
    vehicle.hold_vertical(-50.0, -0.2)
    assert float(earth.geodetic_from_ecef(vehicle.r_e)[2]) == pytest.approx(-50.0, abs=1e-8)
    horizontal = grid.ecef_to_grid(r)[:2] @ (vehicle.r_e - r)
    np.testing.assert_allclose(horizontal, 0.0, atol=1e-8)
    assert vehicle.v_G[2] == -0.2


def test_a_held_batch_gives_the_bits_of_held_steps():
    """On all three axes the increments before go into the next step."""
    dtheta, dvel = signal(20)
    height, v_up = np.linspace(-100.0, -99.0, 20), np.full(20, 0.1)
    expected, found = start(), start()
    previous = ZERO, ZERO
    for a, f, h, up in zip(dtheta, dvel, height, v_up, strict=True):
        strapdown.strapdown_step(*expected, a, f, *previous, 0.01)
        strapdown.hold_vertical(expected[1], expected[2], h, up)
        previous = a, f
    strapdown.strapdown_batch_held(
        *found, dtheta, dvel, np.zeros(3), np.zeros(3), 0.01, height, v_up
    )
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_object_steps_and_runs_alike():
    dtheta, dvel = signal(30)
    one, other = Strapdown(*start()), Strapdown(*start())
    for a, f in zip(dtheta, dvel, strict=True):
        one.step(a, f, 0.01)
    other.run(dtheta[:10], dvel[:10], 0.01)
    other.run(dtheta[10:], dvel[10:], 0.01, block=4)
    np.testing.assert_allclose(one.r_e, other.r_e, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(one.C_b_G, other.C_b_G, rtol=0.0, atol=1e-13)
    before = one.r_e.copy()
    one.run(dtheta[:0], dvel[:0], 0.01)
    np.testing.assert_array_equal(one.r_e, before)


def test_increments():
    t = np.arange(5) * 0.01
    rate, force = np.stack([t, 2 * t, 0 * t], -1), np.stack([0 * t, t, 1 + t], -1)
    dtheta, dvel = increments(rate, force, 0.01)
    np.testing.assert_allclose(dtheta, rate * 0.01)
    dtheta, dvel = increments(rate, force, 0.01, 'instant')
    assert dtheta.shape == (4, 3)
    np.testing.assert_allclose(dvel[0], 0.01 * np.array([0.0, 0.005, 1.005]))
    with pytest.raises(ValueError, match="'mean' or 'instant'"):
        increments(rate, force, 0.01, 'median')
    with pytest.raises(ValueError, match='one shape'):
        increments(rate, force[1:], 0.01)


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ((2 * C_B_G, V_G, position('80N 120E')), 'not a rotation'),
        ((np.diag([1.0, 1.0, -1.0]), V_G, position('80N 120E')), 'not a rotation'),
        ((C_B_G, [np.nan, 0, 0], position('80N 120E')), 'v_G must be one finite'),
        ((C_B_G, np.zeros((2, 3)), position('80N 120E')), 'v_G must be one finite'),
        ((C_B_G, V_G, [0.0, 6378137.0, 0.0]), 'equator at longitude'),
    ],
)
def test_bad_starts_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        Strapdown(*arguments)


def test_bad_steps_are_refused():
    vehicle = Strapdown(*start())
    with pytest.raises(ValueError, match='dt must be positive'):
        vehicle.step(ZERO, ZERO, 0.0)
    with pytest.raises(ValueError, match=r'shape \(3,\)'):
        vehicle.step(np.zeros((2, 3)), ZERO, 0.01)
    with pytest.raises(ValueError, match='block must be at least 1'):
        vehicle.run(np.zeros((2, 3)), np.zeros((2, 3)), 0.01, block=0)
    with pytest.raises(ValueError, match='one shape'):
        vehicle.run(np.zeros((2, 3)), np.zeros((3, 3)), 0.01)
