"""What the paper prints against the exact matrices (docs/misprints.md)."""

import numpy as np
import pytest
from core_places import position
from reference import error_model, published

from polar_nav_core import attitude, earth, grid
from polar_nav_core.error_model import X

V_G = np.array([2.0, 3.0, 0.1])
C_B_G = attitude.matrix_from_euler(1.0, 0.1, 0.05)
F_B = C_B_G.T @ np.array([0.1, 0.2, 9.83])

# (6), (7), (7) with (3,2) corrected, (14), (14) with (2,1) corrected; radius R_N + h
TABLE = {
    (80, 120): (5.3e-3, 1.5e-2, 3.4e-3, 1.9e-2, 1.4e-4),
    (85, 120): (6.7e-4, 3.8e-3, 1.3e-3, 4.6e-3, 3.6e-5),
    (89, 120): (5.5e-6, 3.0e-4, 2.6e-4, 1.9e-4, 1.5e-6),
    (70, 90): (5.7e-2, 7.7e-2, 2.7e-2, 5.4e-4, 5.4e-4),
}


def exact(lat, lon):
    """Exact C_wieR, C_weGR, C_betaR and the radius."""
    r_e = earth.ecef_from_geodetic(lat, lon, -100.0)
    radius = earth.SEMI_MAJOR / np.sqrt(1 - earth.ECCENTRICITY_2 * np.sin(lat) ** 2) - 100.0
    at_rest = error_model.system_matrix(r_e, np.zeros(3), C_B_G, F_B)
    moving = error_model.system_matrix(r_e, V_G, C_B_G, F_B)
    C_wieR = at_rest[X.phi_G, X.dr_e]
    C_weGR = moving[X.phi_G, X.dr_e] - C_wieR
    C_betaR = moving[X.phi_G, X.dv_G] @ grid.ecef_to_grid(r_e)
    return C_wieR, C_weGR, C_betaR, radius


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@pytest.mark.parametrize('place', TABLE)
def test_errors_of_the_printed_matrices(place):
    lat, lon = np.radians(place)
    C_wieR, C_weGR, C_betaR, radius = exact(lat, lon)
    printed = published.C_weGR(lat, lon, radius, V_G[0], V_G[1])
    repaired = printed.copy()
    repaired[2, 1] = published.C_weGR(lat, lon, radius, V_G[0], V_G[1], corrected=True)[2, 1]
    found = (
        relative(published.C_wieR(lat, lon, radius), C_wieR),
        relative(printed, C_weGR),
        relative(repaired, C_weGR),
        relative(published.C_betaR(lat, lon, radius), C_betaR),
        relative(published.C_betaR(lat, lon, radius, corrected=True), C_betaR),
    )
    # two figures are printed
    np.testing.assert_allclose(found, TABLE[place], rtol=0.05)


@pytest.mark.parametrize('place', TABLE)
def test_corrected_matrices_are_right_on_the_sphere(place):
    lat, lon = np.radians(place)
    C_wieR, C_weGR, C_betaR, radius = exact(lat, lon)
    assert relative(published.C_wieR(lat, lon, radius, corrected=True), C_wieR) < 6e-4
    assert relative(published.C_betaR(lat, lon, radius, corrected=True), C_betaR) < 6e-4
    # the transport rate's slope sees the ellipsoid's flattening in full
    assert relative(published.C_weGR(lat, lon, radius, 2.0, 3.0, corrected=True), C_weGR) < 4e-3


def test_printed_and_corrected_coincide_at_the_pole():
    lat, lon, radius = np.radians(90.0 - 1e-6), 0.4, 6.4e6
    for function, extra in (
        (published.C_wieR, ()),
        (published.C_weGR, (2.0, 3.0)),
        (published.C_betaR, ()),
    ):
        one = function(lat, lon, radius, *extra)
        other = function(lat, lon, radius, *extra, corrected=True)
        assert relative(one, other) < 1e-7


def test_C_omega_is_right_as_printed():
    """Angular rate of the sequence z, x, y, by differences of the rotation itself."""
    angles, rates, dt = np.array([0.2, -0.3, 0.5]), np.array([0.7, 0.4, -0.2]), 1e-6

    def rotation(a):
        return attitude.exp([0, 0, a[2]]) @ attitude.exp([a[0], 0, 0]) @ attitude.exp([0, a[1], 0])

    before, after = rotation(angles - rates * dt), rotation(angles + rates * dt)
    omega = attitude.log(before.T @ after) / (2 * dt)
    np.testing.assert_allclose(published.C_omega(*angles[:2]) @ rates, omega, atol=1e-9)
    np.testing.assert_array_equal(published.C_omega(0.0, 0.0), np.eye(3))


def test_observation_matrix():
    printed, corrected = (
        published.observation_matrix(),
        published.observation_matrix(corrected=True),
    )
    assert printed.shape == (24, 6)
    np.testing.assert_array_equal(printed[X.phi_G, :3], np.eye(3))
    np.testing.assert_array_equal(corrected[:3, X.dv_G], np.eye(3))
    np.testing.assert_array_equal(corrected[3:, X.dr_e], np.eye(3))
    assert np.sum(corrected) == 6.0


@pytest.mark.parametrize('name', ['80N 120E', '75S 60W', '70N 90E', 'exact north pole'])
def test_system_matrix_differs_from_the_exact_one_only_by_position(name):
    r_e = position(name)
    F = error_model.system_matrix(r_e, V_G, C_B_G, F_B)
    A = published.system_matrix(r_e, V_G, C_B_G, F_B, corrected=True)
    by_position = np.zeros((15, 15), dtype=bool)
    by_position[:, X.dr_e] = True
    np.testing.assert_array_equal(A[~by_position], F[~by_position])
    assert relative(A[X.phi_G, X.dr_e], F[X.phi_G, X.dr_e]) < 6e-4
    assert relative(A[X.dr_e, X.dr_e], F[X.dr_e, X.dr_e]) < 2e-3
    # the paper drops the gradient of gravity, the largest term of this block
    assert relative(A[X.dv_G, X.dr_e], F[X.dv_G, X.dr_e]) > 0.9


def test_singular_place_is_refused():
    with pytest.raises(ValueError, match='equator at longitude'):
        published.C_betaR(0.0, np.pi / 2, 6.4e6)
