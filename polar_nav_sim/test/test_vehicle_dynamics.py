"""Six degrees of freedom: reference vectors, a matrix twin, energy, a moving frame, the loops."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from polar_nav_core.attitude import matrix_from_euler, skew
from polar_nav_core.vehicle_model import VehicleModel
from polar_nav_sim.kernels import dynamics as kernels

VECTORS = json.loads((Path(__file__).parent / 'data' / 'has_dynamics.json').read_text())
VEHICLE = VECTORS['dynamics'][0]['vehicle']
NO_WRENCH, NOTHING_WANTED = np.full(6, math.nan), np.full(4, math.nan)


def numbers(values):
    return np.array(values, dtype=np.float64)


def mass_matrix(v):
    r_g, m = numbers(v['r_g']), v['m']
    inertia = np.diag(numbers(v['I_origin']))
    rigid = np.block([[m * np.eye(3), -m * skew(r_g)], [m * skew(r_g), inertia]])
    return rigid, np.diag(numbers(v['added_mass']))


def body_of(v):
    rigid, added = mass_matrix(v)
    return kernels.Body(
        np.linalg.inv(rigid + added),
        float(v['m']),
        numbers(v['r_g']),
        np.diag(numbers(v['I_origin'])),
        numbers(v['added_mass']),
        numbers(v['d1']),
        numbers(v['d2']),
        float(v['W']),
        float(v['B']),
        numbers(v['r_b']),
    )


def rates(x, tau, V, dV, body):
    dx = np.zeros(12)
    kernels.derivative(dx, numbers(x), numbers(tau), numbers(V), numbers(dV), body, scratch(10))
    return dx


def scratch(rows):
    return np.zeros((rows, 3))


def loops(**changes):
    values = {
        'surge': numbers([52, 18, 0.05, 0, 14, 0.013, 0]),
        'heading': numbers([0.3, 1.9, 0.011, 0, 0.45, 0.037, 0]),
        'depth': 20.0,
        'speed': math.nan,
        'gains': numbers([200, 120, 400, 200, 30, 150, 100]),
        'limits': numbers([150, 0, 100, 0, 100, 60]),
        'origin_depth': 0.0,
        'half_curvature': 0.0,
    }
    return kernels.Loops(**{**values, **changes})


def water(V, change=0.0, turn=0.0):
    return kernels.Water(
        math.hypot(V[0], V[1]), math.atan2(V[1], V[0]), float(V[2]), change, turn, 1800.0
    )


def run(x0, steps, body, current, wrench=NO_WRENCH, wanted=NOTHING_WANTED, laws=None, h=0.01):
    x, tau = np.zeros((steps + 1, 12)), np.zeros((steps, 6))
    x[0] = x0
    start, end = np.zeros((steps, 12)), np.zeros((steps, 12))
    kernels.run(
        x,
        tau,
        start,
        end,
        0,
        steps,
        h,
        body,
        current,
        laws or loops(),
        wanted,
        wrench,
        scratch(30),
    )
    return x, tau, start, end


def twin(x, tau, V, dV, v):
    """The matrix form of Fossen (Lagrangian Coriolis), as it stands in the derivation."""
    R = matrix_from_euler(x[5], x[4], x[3])
    nu, w = x[6:], x[9:]
    v_c = R.T @ V
    nu_r = nu - np.concatenate([v_c, np.zeros(3)])
    rate_c = np.concatenate([-np.cross(w, v_c) + R.T @ dV, np.zeros(3)])
    rigid, added = mass_matrix(v)

    def coriolis(M, speeds):
        p = M[:3, :3] @ speeds[:3] + M[:3, 3:] @ speeds[3:]
        q = M[3:, :3] @ speeds[:3] + M[3:, 3:] @ speeds[3:]
        return np.block([[np.zeros((3, 3)), -skew(p)], [-skew(p), -skew(q)]])

    drag = np.diag(numbers(v['d1']) + numbers(v['d2']) * np.abs(nu_r))
    down = R.T @ [0.0, 0.0, -1.0]
    weight, lift = v['W'] * down, -v['B'] * down
    moments = np.cross(v['r_g'], weight) + np.cross(v['r_b'], lift)
    g = -np.concatenate([weight + lift, moments])
    right = tau + added @ rate_c - coriolis(rigid, nu) @ nu - coriolis(added, nu_r) @ nu_r
    dnu = np.linalg.solve(rigid + added, right - drag @ nu_r - g)
    phi, theta = x[3], x[4]
    J = np.array(
        [
            [1.0, math.sin(phi) * math.tan(theta), math.cos(phi) * math.tan(theta)],
            [0.0, math.cos(phi), -math.sin(phi)],
            [0.0, math.sin(phi) / math.cos(theta), math.cos(phi) / math.cos(theta)],
        ]
    )
    return np.concatenate([R @ nu[:3], J @ w, dnu])


@pytest.mark.parametrize('case', VECTORS['dynamics'], ids=lambda c: c['name'])
def test_reference_vectors(case):
    got = rates(
        case['eta'] + case['nu'], case['tau'], case['Vc'], case['dVc'], body_of(case['vehicle'])
    )
    np.testing.assert_allclose(got, case['deta'] + case['dnu'], rtol=1e-9, atol=1e-12)


def test_matrix_twin_at_random_states():
    rng = np.random.default_rng(6)
    v = VECTORS['dynamics'][2]['vehicle']
    for _ in range(50):
        x = rng.uniform(-1.2, 1.2, 12)
        tau, V, dV = rng.uniform(-50, 50, 6), rng.uniform(-1, 1, 3), rng.uniform(-0.1, 0.1, 3)
        expected = twin(x, tau, V, dV, v)
        np.testing.assert_allclose(
            rates(x, tau, V, dV, body_of(v)), expected, rtol=1e-9, atol=1e-9
        )


def test_five_seconds_of_runge_kutta():
    r = VECTORS['rk4_5s']
    x, *_ = run(
        r['eta0'] + r['nu0'],
        r['steps'],
        body_of(VEHICLE),
        water(numbers(r['Vc'])),
        wrench=numbers(r['tau']),
        h=r['h'],
    )
    np.testing.assert_allclose(x[-1], r['eta'] + r['nu'], rtol=1e-9, atol=1e-9)


def test_energy_is_kept_without_drag_and_thrust():
    v = {**VECTORS['dynamics'][2]['vehicle'], 'd1': [0.0] * 6, 'd2': [0.0] * 6}
    rigid, added = mass_matrix(v)
    start = [0, 0, -20, 0.1, -0.2, 0.3, 1.0, -0.3, 0.2, 0.05, 0.1, -0.15]
    x, *_ = run(start, 2000, body_of(v), water(np.zeros(3)), wrench=np.zeros(6))
    up = matrix_from_euler(x[:, 5], x[:, 4], x[:, 3])[:, 2]
    kinetic = 0.5 * np.einsum('ni,ij,nj->n', x[:, 6:], rigid + added, x[:, 6:])
    potential = v['W'] * (x[:, 2] + up @ v['r_g']) - v['B'] * (x[:, 2] + up @ v['r_b'])
    energy = kinetic + potential
    assert np.ptp(kinetic) > 10.0
    assert np.ptp(energy) < 1e-6 * kinetic.max()


def test_a_constant_current_is_a_moving_frame():
    V = np.array([0.4, -0.25, 0.03])
    start = numbers([0, 0, -20, 0.1, -0.2, 0.3, 1.0, -0.3, 0.2, 0.05, 0.1, -0.15])
    moved = start.copy()
    moved[6:9] += matrix_from_euler(0.3, -0.2, 0.1).T @ V
    wrench = numbers([30, 5, -4, 0.1, 2, -3])
    body = body_of(VECTORS['dynamics'][2]['vehicle'])
    still, *_ = run(start, 1000, body, water(np.zeros(3)), wrench=wrench)
    drifting, *_ = run(moved, 1000, body, water(V), wrench=wrench)
    t = 0.01 * np.arange(1001)[:, None]
    np.testing.assert_allclose(drifting[:, :3], still[:, :3] + t * V, atol=1e-8)
    np.testing.assert_allclose(drifting[:, 3:6], still[:, 3:6], atol=1e-9)
    # And it is the current that does it.
    assert np.abs(run(moved, 1000, body, water(np.zeros(3)), wrench=wrench)[0] - still).max() > 1.0


def test_translation_is_that_of_the_reduced_model():
    """Rows 1-3 with r_g = 0 hold whatever the angular acceleration: the couplings vanish."""
    rng = np.random.default_rng(3)
    v = VEHICLE
    model = VehicleModel.of(v['m'], v['added_mass'][:3], v['d1'][:3], v['d2'][:3], v['B'] - v['W'])
    for _ in range(20):
        x, tau, V = rng.uniform(-1.2, 1.2, 12), rng.uniform(-50, 50, 6), rng.uniform(-1, 1, 3)
        R = matrix_from_euler(x[5], x[4], x[3])
        v_c = R.T @ V
        dnu = rates(x, tau, V, np.zeros(3), body_of(v))[6:9]
        relative = dnu + np.cross(x[9:], v_c)
        expected = model.acceleration(x[6:9] - v_c, x[9:].copy(), R, tau[:3].copy())
        np.testing.assert_allclose(relative, expected, atol=1e-12)


def test_rate_of_the_current_is_its_slope():
    W = water(np.array([0.4, 0.25, 0.01]), change=0.3, turn=0.6)
    V, dV, low, high, unused = (np.zeros(3) for _ in range(5))
    for t in (0.0, 333.0, 1500.0):
        kernels.current(V, dV, t, W)
        kernels.current(low, unused, t - 1.0, W)
        kernels.current(high, unused, t + 1.0, W)
        np.testing.assert_allclose(dV, 0.5 * (high - low), atol=1e-8)
    kernels.current(V, dV, 0.0, W)
    np.testing.assert_allclose(V, [0.4, 0.25, 0.01], atol=1e-15)
    kernels.current(V, dV, 450.0, W)
    assert math.hypot(V[0], V[1]) == pytest.approx(1.3 * math.hypot(0.4, 0.25))
    assert math.atan2(V[1], V[0]) == pytest.approx(math.atan2(0.25, 0.4) + 0.6)


def test_rates_at_both_ends_of_a_step_have_its_thrust():
    start = [0, 0, -20, 0, 0, 0.3, 1.1, 0, 0, 0, 0, 0]
    V = np.array([0.4, 0.25, 0.0])
    x, tau, first, last = run(start, 5, body_of(VEHICLE), water(V))
    for k in range(5):
        for state, got in ((x[k], first[k]), (x[k + 1], last[k])):
            expected = rates(state, tau[k], V, np.zeros(3), body_of(VEHICLE))
            np.testing.assert_allclose(got, expected, atol=1e-13)


def test_loops_hold_what_is_wanted():
    start = [0, 0, -20, 0, 0, 0.3, 1.1, 0, 0, 0, 0, 0]
    wanted = numbers([-2.0, math.nan, 35.0, 0.9])
    x, tau, *_ = run(
        start, 12000, body_of(VEHICLE), water(np.array([0.4, 0.25, 0.0])), wanted=wanted
    )
    end = x[-1]
    V_b = matrix_from_euler(end[5], end[4], end[3]).T @ [0.4, 0.25, 0.0]
    assert math.remainder(end[5] + 2.0, 2 * math.pi) == pytest.approx(0.0, abs=1e-3)
    assert end[2] == pytest.approx(-35.0, abs=0.01)
    assert end[6] - V_b[0] == pytest.approx(0.9, abs=1e-3)
    assert abs(end[4]) < 1e-3
    assert np.all(np.abs(tau) <= loops().limits)
    # Depth wins over pitch; pitch alone is held.
    wanted = numbers([math.nan, 0.1, math.nan, 1.0])
    x, *_ = run(start, 6000, body_of(VEHICLE), water(np.zeros(3)), wanted=wanted)
    assert x[-1, 4] == pytest.approx(0.1, abs=0.03)
    assert x[-1, 2] < -21.0


def test_a_pitch_loop_below_the_munk_moment_dives():
    start = [0, 0, -20, 0, 0.02, 0.3, 1.2, 0, 0, 0, 0, 0]
    weak = loops(gains=numbers([200, 120, 60, 200, 30, 150, 100]))
    body, still = body_of(VEHICLE), water(np.zeros(3))
    assert np.abs(run(start, 6000, body, still, laws=weak)[0][:, 4]).max() > 0.3
    assert np.abs(run(start, 6000, body, still)[0][:, 4]).max() < 0.03
