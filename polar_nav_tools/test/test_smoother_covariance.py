"""Stated sigmas of the smoother against a covariance recursion written from the model alone.

Rauch, Tung and Striebel in NumPy, about the true track, with an error model to first order: none
of the engine's transitions, rows or recursions are used. Signs as in docs/frames.md.
"""

import numpy as np
import pytest

from polar_nav_core.engine import smoothing
from polar_nav_core.error_model import X
from polar_nav_tools.benchmarks.factor_graph import AS_STATED
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec

STEP_S = 0.1
EARTH_RATE, RADIUS, GRAVITY = 7.292e-5, 6.39e6, 9.83
USED = 21  # without the USBL error, which is no state here

WORLDS = {
    '6.1': {'imu': 'paper_6_1'},
    '6.2': {'imu': 'paper_6_2'},
    'tactical': {'imu': 'tactical', 'gyro_bias_dph': 1.0, 'accel_bias_g': 5e-4},
    'without a DVL': {'imu': 'paper_6_1', 'dvl_rate_hz': 0.0},
}


def skew(a):
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def grid_axes(r_e):
    """ECEF to grid: up, and north along the Greenwich meridian's direction, on a sphere."""
    up = r_e / np.linalg.norm(r_e)
    # The grid's north lies in the plane of up and the axis through longitude 180.
    north = np.array([-1.0, 0.0, 0.0])
    north -= up * (north @ up)
    north /= np.linalg.norm(north)
    return np.array([np.cross(north, up), north, up])


def transition(params, C_b_G, C_e_G, v_G, f_G, dt):
    """Phi (21, 21) over a step, by the exponential of the first-order error model."""
    F = np.zeros((USED, USED))
    rate_G = EARTH_RATE * C_e_G[:, 2]
    # What turns the axes when the vehicle moves over a sphere: up x v / R.
    over = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) / RADIUS
    F[X.phi_G, X.phi_G] = -skew(rate_G + over @ v_G)
    F[X.phi_G, X.dv_G] = over
    F[X.phi_G, X.b_gyro_b] = -C_b_G
    F[X.dv_G, X.phi_G] = skew(f_G)
    F[X.dv_G, X.dv_G] = -skew(2.0 * rate_G + over @ v_G) + skew(v_G) @ over
    up_e = C_e_G[2]
    F[X.dv_G, X.dr_e] = np.outer([0.0, 0.0, 2.0 * GRAVITY / RADIUS], up_e)
    F[X.dv_G, X.b_accel_b] = C_b_G
    F[X.dr_e, X.dv_G] = C_e_G.T
    F[X.dvl_markov_m, X.dvl_markov_m] = -np.eye(3) / params.dvl_markov_tau
    A = F * dt
    return np.eye(USED) + A @ (np.eye(USED) + A @ (np.eye(USED) / 2.0 + A / 6.0))


def noise(params, dt):
    """Covariance (21, 21) that a step adds."""
    q = np.zeros(USED)
    for block, density in (
        (X.phi_G, params.gyro_noise_density),
        (X.dv_G, params.accel_noise_density),
        (X.b_gyro_b, params.gyro_bias_walk),
        (X.b_accel_b, params.accel_bias_walk),
    ):
        q[block] = density**2 * dt
    q[X.dvl_markov_m] = 2.0 * params.dvl_markov_sigma**2 / params.dvl_markov_tau * dt
    return np.diag(q)


def start(params, C_e_G):
    P = np.zeros((USED, USED))
    level = [np.radians(params.initial_sigma_tilt_deg)] * 2
    heading = np.radians(params.initial_sigma_heading_deg)
    P[X.phi_G, X.phi_G] = np.diag(np.square([*level, heading]))
    P[X.dv_G, X.dv_G] = params.initial_sigma_velocity**2 * np.eye(3)
    place = np.square([*[params.initial_sigma_position] * 2, params.initial_sigma_height])
    P[X.dr_e, X.dr_e] = C_e_G.T @ np.diag(place) @ C_e_G
    P[X.b_gyro_b, X.b_gyro_b] = params.gyro_bias_sigma**2 * np.eye(3)
    P[X.b_accel_b, X.b_accel_b] = params.accel_bias_sigma**2 * np.eye(3)
    P[X.dvl_scale_m, X.dvl_scale_m] = params.dvl_scale_sigma**2 * np.eye(3)
    P[X.dvl_markov_m, X.dvl_markov_m] = params.dvl_markov_sigma**2 * np.eye(3)
    return P


def updated(P, H, R):
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    A = np.eye(USED) - K @ H
    return A @ P @ A.T + K @ R @ K.T


def measurements(inputs):
    """Pings, depths and fixes as (stamp, kind, covariance), in order of their validity."""
    out = [
        (int(s), 'dvl', R)
        for s, R in zip(inputs.dvl_stamps_ns, inputs.dvl_covariance_m, strict=True)
    ]
    out += [
        (int(s), 'depth', R * np.eye(1))
        for s, R in zip(inputs.depth_stamps_ns, inputs.depth_variance, strict=True)
    ]
    out += [(f.validity_ns, 'fix', f.covariance_e) for f in inputs.fixes]
    return sorted(out, key=lambda m: m[0])


def row(kind, R, C_b_G, C_e_G, v_G):
    """H (m, 21) and its noise (m, m) of a measurement without lever arms."""
    if kind == 'fix':
        H = np.zeros((3, USED))
        H[:, X.dr_e] = np.eye(3)
        return H, R
    if kind == 'depth':
        H = np.zeros((1, USED))
        H[0, X.dr_e] = C_e_G[2]
        return H, R
    H = np.zeros((3, USED))
    H[:, X.phi_G] = -skew(v_G)
    H[:, X.dv_G] = np.eye(3)
    H[:, X.dvl_scale_m] = -C_b_G * (C_b_G.T @ v_G)
    H[:, X.dvl_markov_m] = -C_b_G
    return H, C_b_G @ R @ C_b_G.T


def recursion(world, params, stamps_ns):
    """Smoothed covariances (k, 21, 21) at stamps of whole steps."""
    first_ns = int(world.inputs.imu_stamps_ns[0])
    step_ns = round(STEP_S * 1e9)
    last_ns = int(world.inputs.imu_stamps_ns[-1])
    ends = np.arange(first_ns // step_ns + 1, last_ns // step_ns + 1) * step_ns
    begins = np.concatenate([[first_ns], ends[:-1]])
    before, now = world.truth.state(begins), world.truth.state(ends)
    middle = world.truth.state((begins + ends) // 2)
    waiting = [m for m in measurements(world.inputs) if m[0] >= ends[0]]
    P = start(params, grid_axes(before.r_e[0]))
    predicted, filtered, steps = [], [P], []
    n = 0
    for k, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        C_e_G, dt = grid_axes(middle.r_e[k]), (end - begin) * 1e-9
        f_G = (now.v_G[k] - before.v_G[k]) / dt + [0.0, 0.0, GRAVITY]
        C = middle.C_b_G[k]
        Phi = transition(params, C, C_e_G, middle.v_G[k], f_G, dt)
        P = Phi @ P @ Phi.T + noise(params, dt)
        predicted.append(P)
        steps.append(Phi)
        while n < len(waiting) and waiting[n][0] < end + step_ns:
            _, kind, R = waiting[n]
            P = updated(P, *row(kind, R, now.C_b_G[k], grid_axes(now.r_e[k]), now.v_G[k]))
            n += 1
        filtered.append(P)
    smoothed = filtered[-1]
    out = {int(ends[-1]): smoothed}
    for k in range(len(ends) - 1, 0, -1):
        unit = np.sqrt(np.diagonal(predicted[k]))
        scaled = predicted[k] / np.outer(unit, unit)
        G = np.linalg.solve(scaled, (steps[k] @ filtered[k]) / unit[:, None]).T / unit
        smoothed = filtered[k] + G @ (smoothed - predicted[k]) @ G.T
        out[int(ends[k - 1])] = smoothed
    return np.array([out[int(s)] for s in stamps_ns])


def horizontal(P, r_e):
    C = np.array([grid_axes(r) for r in r_e])
    P_G = C @ P[:, X.dr_e, X.dr_e] @ np.swapaxes(C, 1, 2)
    return np.sqrt(P_G[:, 0, 0] + P_G[:, 1, 1])


@pytest.mark.slow
@pytest.mark.parametrize('name', WORLDS)
def test_stated_sigmas_are_those_of_a_recursion_of_its_own(name):
    spec = WorldSpec(mission='demo', duration_s=600.0, constants='prior', **WORLDS[name])
    world = make_world(spec, FixSpec(period_s=2.0, first_s=2.0, delay_s=5.0), 1)
    params = world.params(**AS_STATED)
    track = smoothing.smooth(params, world.inputs, covariances=True, passes=1).track
    stamps = track.stamps_ns
    expected = recursion(world, params, stamps)
    truth = world.truth.state(stamps)
    P = track.P[:, :USED, :USED]
    np.testing.assert_allclose(
        horizontal(P, truth.r_e), horizontal(expected, truth.r_e), rtol=0.02
    )
    stated, found = (np.sqrt(np.einsum('nii->ni', x)) for x in (P, expected))
    np.testing.assert_allclose(stated, found, rtol=0.02)
