"""The 15-state matrix: reference vectors, NumPy twin, nonlinear equations run perturbed."""

import core_twin as twin
import numpy as np
import pytest
from core_places import PLACES, STATES, position
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import error_model
from reference.error_model import SINS, Navigation, W
from scipy.linalg import expm

from polar_nav_core import attitude, earth, grid
from polar_nav_core.error_model import X
from polar_nav_core.kernels.frames import strapdown

C_B_G = attitude.matrix_from_euler(2.0, 0.1, -0.2)
V_G = np.array([2.0, -3.0, 0.3])
F_B = C_B_G.T @ np.array([0.3, -0.2, 9.83])


def block_error(F, expected):
    """Largest relative Frobenius error over the 3 x 3 blocks."""
    worst = 0.0
    for i in range(0, len(F), 3):
        for j in range(0, len(F), 3):
            block = expected[i : i + 3, j : j + 3]
            error = np.linalg.norm(F[i : i + 3, j : j + 3] - block)
            worst = max(worst, error / np.linalg.norm(block) if np.any(block) else error)
    return worst


def test_blocks_tile_the_state():
    for blocks in (X, W):
        covered = [i for block in blocks for i in range(block.start, block.stop)]
        assert covered == list(range(blocks.size))
    assert X.size == 24
    assert slice(0, 15) == SINS
    assert X._fields == (
        'phi_G', 'dv_G', 'dr_e', 'b_gyro_b', 'b_accel_b',
        'dvl_scale_m', 'dvl_markov_m', 'usbl_bias_a',
    )  # fmt: skip


@pytest.mark.parametrize('name', STATES)
def test_reference_vectors(name):
    state = STATES[name]['input']
    F = error_model.system_matrix(state['R_e'], state['V_G'], state['C_b_G'], state['f_b'])
    assert block_error(F, np.array(STATES[name]['expected']['F15'])) < 1e-12


def twin_matrix(r, v, C, f_b):
    """F15 in matrices, slopes of rates and gravity by central differences of the twin."""
    u, h = twin.geodetic(r)
    C_e_G = twin.axes(u)
    w_ie, w_eG = twin.rates(r, v)
    K = twin.curvature(u, h)
    kappa = u[1] / np.hypot(u[0], u[2])
    Bg = np.array([[-K[0, 1], -K[1, 1], 0], [K[0, 0], K[0, 1], 0], [0, 0, 0]])
    Bg[2] = kappa * Bg[0]
    C_betaR = Bg @ C_e_G
    C_wieR = twin.cross(w_ie) @ C_betaR
    step = 500.0 * np.hypot(u[0], u[2])
    C_weGR = np.zeros((3, 3))
    slope = np.zeros(3)
    for k, e in enumerate(np.eye(3) * step):
        one, other = twin.geodetic(r + e), twin.geodetic(r - e)
        C_weGR[:, k] = (twin.rates(r + e, v)[1] - twin.rates(r - e, v)[1]) / (2 * step)
        slope[k] = (twin.gravity(one[0][2], one[1]) - twin.gravity(other[0][2], other[1])) / (
            2 * step
        )
    F = np.zeros((15, 15))
    F[X.phi_G, X.phi_G] = -twin.cross(w_ie + w_eG)
    F[X.phi_G, X.dv_G] = Bg
    F[X.phi_G, X.dr_e] = C_wieR + C_weGR
    F[X.phi_G, X.b_gyro_b] = -C
    F[X.dv_G, X.phi_G] = twin.cross(C @ f_b)
    F[X.dv_G, X.dv_G] = twin.cross(v) @ Bg - twin.cross(2 * w_ie + w_eG)
    F[X.dv_G, X.dr_e] = twin.cross(v) @ (2 * C_wieR + C_weGR)
    F[X.dv_G.stop - 1, X.dr_e] -= slope
    F[X.dv_G, X.b_accel_b] = C
    F[X.dr_e, X.dv_G] = C_e_G.T
    F[X.dr_e, X.dr_e] = -C_e_G.T @ twin.cross(v) @ C_betaR
    return F


@pytest.mark.parametrize('name', PLACES)
def test_matrix_equals_the_plain_twin(name):
    r_e = position(name)
    F = error_model.system_matrix(r_e, V_G, C_B_G, F_B)
    # differences over 500 m: second-order error of the numerical slopes
    assert block_error(F, twin_matrix(r_e, V_G, C_B_G, F_B)) < 2e-6


@settings(max_examples=50)
@given(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0), st.floats(-11e3, 20e3))
def test_matrix_equals_the_twin_anywhere(lat_deg, lon_deg, height):
    r_e = earth.ecef_from_geodetic(np.radians(lat_deg), np.radians(lon_deg), height)
    u = earth.up(r_e)
    if np.hypot(u[0], u[2]) < 0.01:
        return
    F = error_model.system_matrix(r_e, V_G, C_B_G, F_B)
    assert block_error(F, twin_matrix(r_e, V_G, C_B_G, F_B)) < 1e-5


def propagate(navigation, omega, f, steps, dt=0.01):
    """The nonlinear strapdown; constant rate and force plus the biases left."""
    C, v, r = navigation.C_b_G.copy(), navigation.v_G.copy(), navigation.r_e.copy()
    a, b = (omega + navigation.b_gyro_b) * dt, (f + navigation.b_accel_b) * dt
    for _ in range(steps):
        strapdown.strapdown_step(C, v, r, a, b, a, b, dt)
    return Navigation(C, v, r)


def difference(estimate, truth):
    """Error vector of the first nine states."""
    return np.concatenate(
        [
            attitude.log(truth.C_b_G @ estimate.C_b_G.T),
            estimate.v_G - truth.v_G,
            estimate.r_e - truth.r_e,
        ]
    )


@pytest.mark.parametrize(
    'name',
    [
        'exact north pole',
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ['80N 120E', '75S 60W', '89.99N at 180E']
        ),
    ],
)
@pytest.mark.parametrize('state', range(15))
def test_the_nonlinear_equations_follow_the_matrix(name, state):
    """Run clean and perturbed for 10 s: the difference is Phi x, signs and units and all."""
    size = np.repeat([1e-5, 1e-2, 10.0, 1e-6, 1e-3], 3)[state]
    x = np.zeros(24)
    x[state] = size
    truth = Navigation(C_B_G, V_G, position(name))
    estimate = truth.corrected(-x)
    # corrected(-x) puts the error x in; the sensor errors of the estimate are then "truth minus
    # estimate" = x
    estimate = Navigation(
        estimate.C_b_G, estimate.v_G, estimate.r_e, x[X.b_gyro_b], x[X.b_accel_b]
    )
    omega, f = np.array([0.0, 0.0, 1e-3]), C_B_G.T @ np.array([0.02, 0.01, 9.83])
    expected = x[:15]
    for _ in range(10):
        middle = propagate(truth, omega, f, 50)
        F = error_model.system_matrix(middle.r_e, middle.v_G, middle.C_b_G, f)
        expected = expm(F) @ expected
        truth = propagate(truth, omega, f, 100)
    found = difference(propagate(estimate, omega, f, 1000), truth)
    scale = np.maximum(np.repeat([1e-6, 1e-4, 1e-2], 3), np.abs(expected[:9]))
    assert np.all(np.abs(found - expected[:9]) < 3e-4 * scale), (found, expected)


def test_transition_is_the_exponential_to_second_order():
    F = error_model.system_matrix(position('80N 120E'), V_G, C_B_G, F_B)
    A = error_model.full_system_matrix(F, tau_dvl=300.0, tau_usbl=100.0)
    errors = [np.max(np.abs(error_model.transition(A, dt) - expm(A * dt))) for dt in (0.4, 0.2)]
    assert np.log2(errors[0] / errors[1]) > 2.9
    assert A[X.dvl_markov_m, X.dvl_markov_m][0, 0] == -1.0 / 300.0
    assert A[X.usbl_bias_a, X.usbl_bias_a][2, 2] == -0.01
    assert not np.any(A[X.b_gyro_b])
    with pytest.raises(ValueError, match='correlation time'):
        error_model.full_system_matrix(F, tau_dvl=0.0)


def test_noise_enters_where_it_should():
    B = error_model.noise_input(C_B_G)
    np.testing.assert_array_equal(B[X.phi_G, W.gyro_b], -C_B_G)
    np.testing.assert_array_equal(B[X.dv_G, W.accel_b], C_B_G)
    assert not np.any(B[X.dr_e])
    assert not np.any(B[X.dvl_scale_m])
    density = np.zeros(W.size)
    density[W.gyro_b] = 2e-5
    sigma, tau, dt = 0.005, 300.0, 0.1
    density[W.dvl_markov_m] = error_model.markov_density(sigma, tau)
    A = error_model.full_system_matrix(np.zeros((15, 15)), tau_dvl=tau)
    Q = error_model.process_noise(error_model.transition(A, dt), B, density, dt)
    np.testing.assert_allclose(Q[X.phi_G, X.phi_G], (2e-5) ** 2 * dt * np.eye(3), atol=1e-25)
    exact = sigma**2 * (1.0 - np.exp(-2.0 * dt / tau))
    np.testing.assert_allclose(np.diag(Q)[X.dvl_markov_m], exact, rtol=1e-6)
    np.testing.assert_array_equal(Q, Q.T)


def test_corrected_takes_an_error_out():
    x = np.arange(24) * 1e-3
    navigation = Navigation(C_B_G, V_G, position('80N 120E'))
    back = navigation.corrected(x).corrected(-x)
    np.testing.assert_allclose(back.r_e, navigation.r_e, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(back.C_b_G, navigation.C_b_G, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(navigation.corrected(x).usbl_bias_a, x[21:], rtol=0.0, atol=1e-18)


@pytest.mark.parametrize('lon', [90.0, -90.0])
def test_singular_place_is_refused(lon):
    with pytest.raises(ValueError, match='equator at longitude'):
        error_model.system_matrix([0.0, np.sign(lon) * 6378137.0, 0.0], V_G, C_B_G, F_B)
    with pytest.raises(ValueError, match='must be a single one'):
        error_model.system_matrix(np.ones((2, 3)) * 4e6, V_G, C_B_G, F_B)
    assert grid.SINGULAR_DELTA == 1e-8
