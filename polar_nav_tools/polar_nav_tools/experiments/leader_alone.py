"""Drift of a leader that navigates by itself, without absolute fixes.

``python -m polar_nav_tools.experiments.leader_alone`` prints a table. A straight run, the
simulation's leader instruments, the engine with the parameters of leader_node; no ROS. The drift
that the instruments' specification leads to is worked out by hand beside it (:func:`expected`), so
that the filter's own covariance is checked, and with it the scatter.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE
from polar_nav_core.error_model import X
from polar_nav_core.params import default_of, from_mapping
from polar_nav_leader.params import LeaderParams
from polar_nav_sim.initial_state import InitialSigma, initial_parameters
from polar_nav_sim.mission import Mission, mission_from
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.depth import DepthErrors, DepthSensor
from polar_nav_sim.sensors.dvl import DvlSensor
from polar_nav_sim.sensors.imu import ImuSensor
from polar_nav_sim.sensors.presets import DVL, IMU
from polar_nav_sim.trajectory import Truth

Array = NDArray[np.float64]

SPEED = 3.0
LATITUDE_DEG = 80.0
_IMU_HZ, _DVL_HZ, _DEPTH_HZ = 50.0, 5.0, 10.0
_OUTPUT_S = 10.0


@dataclass(frozen=True)
class Drift:
    """Errors of one run against the truth, k epochs.

    Attributes
    ----------
    time_s : (k,) array
        Since the start.
    along, cross, up : (k,) arrays
        Position error along the course, across it (to port) and upwards [m].
    sigma_along, sigma_cross : (k,) arrays
        Sigmas published by the filter for the first two [m].
    nees : (k,) array
        Of position, 3 degrees of freedom.
    heading, sigma_heading : (k,) arrays
        Error about up, and its published sigma [rad].
    """

    time_s: Array
    along: Array
    cross: Array
    up: Array
    sigma_along: Array
    sigma_cross: Array
    nees: Array
    heading: Array
    sigma_heading: Array


@dataclass(frozen=True)
class Expected:
    """Least and largest 1-sigma of the drift by the instruments' specification alone [m]."""

    along: tuple[float, float]
    cross: tuple[float, float]


def expected(duration_s: float, params: LeaderParams | None = None) -> Expected:
    """Bounds of the drift after a straight run, in closed form.

    Along the course the DVL's scale error s grows with the distance D. The attitude oscillates,
    so an inertial system sees that the three axes of the DVL differ, but never what they have in
    common: between s D / sqrt(3) and s D. The slowly varying error, sigma_m and tau, adds the
    variance 2 sigma_m^2 tau (T - tau (1 - exp(-T / tau))) at most; the inertial system sees some
    of it, too.

    Across the course it is the heading error times D. At most that is the initial one with the
    gyro bias that turns it, sqrt(sigma_0^2 + (b T / 2)^2). At least it is what is left when the
    gyros have been a compass for long, sigma_c = b / (Omega cos(latitude)), and the DVL was
    compared with the velocity at the start, sigma_v / V: 1 / sigma^2 = 1 / sigma_0^2 +
    1 / sigma_c^2 + V^2 / sigma_v^2.
    """
    p = LeaderParams() if params is None else params
    T, D = duration_s, SPEED * duration_s
    tau = p.dvl_markov_tau
    start = p.initial_sigma_position**2
    slow = 2.0 * p.dvl_markov_sigma**2 * tau * (T + tau * math.expm1(-T / tau))
    first = math.radians(p.initial_sigma_heading_deg)
    compass = p.gyro_bias_sigma / (earth.OMEGA_IE * math.cos(math.radians(LATITUDE_DEG)))
    by_velocity = math.hypot(p.initial_sigma_velocity, p.dvl_markov_sigma) / SPEED
    least = (first**-2 + compass**-2 + by_velocity**-2) ** -0.5
    most = math.hypot(first, 0.5 * p.gyro_bias_sigma * T)
    scale = (p.dvl_scale_sigma * D) ** 2
    return Expected(
        along=(math.sqrt(start + scale / 3.0), math.sqrt(start + scale + slow)),
        cross=(math.sqrt(start + (least * D) ** 2), math.sqrt(start + (most * D) ** 2 + slow)),
    )


def run(duration_s: float, seed: int) -> Drift:
    """Drift of the navigation in one run.

    Raises
    ------
    RuntimeError
        When the filter diverged.
    """
    mission, truth, delta_theta_b, delta_v_b = _ideal(duration_s)
    stamps = mission.start_ns + mission.imu_period_ns * np.arange(
        1, len(delta_theta_b) + 1, dtype=np.int64
    )
    imu = ImuSensor(IMU['leader'].errors, 1.0 / _IMU_HZ, stream(seed, 'leader/imu'))
    omega_b, f_b = imu.measure(1, delta_theta_b, delta_v_b)
    dvl_stamps, dvl_v_m, dvl_covariance_m = _pings(truth, stamps, seed)
    depth_stamps, depth, variance = _depths(truth, stamps, seed)
    inputs = engine_run.Inputs(
        imu_stamps_ns=stamps,
        omega_ib_b=omega_b,
        f_b=f_b,
        dvl_stamps_ns=dvl_stamps,
        dvl_v_m=dvl_v_m,
        dvl_covariance_m=dvl_covariance_m,
        dvl_valid=np.ones(len(dvl_stamps), dtype=bool),
        depth_stamps_ns=depth_stamps,
        depth=depth,
        depth_variance=np.full(len(depth), variance),
    )
    result = engine_run.run(_params(truth, int(stamps[0]), seed), inputs)
    if result.divergence:
        raise RuntimeError(f'seed {seed}: {result.divergence}')
    return _drift(truth, mission.start_ns, result.track)


@lru_cache(maxsize=1)
def _ideal(duration_s: float) -> tuple[Mission, Truth, Array, Array]:
    """Truth and the ideal increments of every IMU interval."""
    document: dict[str, Any] = {
        'duration_s': duration_s,
        'imu_rate_hz': _IMU_HZ,
        'path': {
            'kind': 'straight',
            'latitude_deg': LATITUDE_DEG,
            'longitude_deg': 120.0,
            'course_deg': 30.0,
            'speed_mps': SPEED,
        },
        'vehicles': {'leader': {'role': 'leader', 'depth_m': 60.0}, 'follower': {}},
    }
    mission = mission_from(document, Path('leader_alone'))
    truth = mission.truth('leader')
    n = mission.sample_count - 1
    parts = [truth.samples(k, min(k + 50_000, n + 1)) for k in range(1, n + 1, 50_000)]
    delta_theta_b = np.concatenate([part.delta_theta_b for part in parts])
    delta_v_b = np.concatenate([part.delta_v_b for part in parts])
    return mission, truth, delta_theta_b, delta_v_b


def _pings(
    truth: Truth, stamps: NDArray[np.int64], seed: int
) -> tuple[NDArray[np.int64], Array, Array]:
    stride = round(_IMU_HZ / _DVL_HZ)
    chosen = stamps[stride - 1 :: stride]
    sensor = DvlSensor(DVL['leader'].errors, 1.0 / _DVL_HZ, stream(seed, 'leader/dvl'))
    state = truth.state(chosen)
    v_b = np.einsum('nji,nj->ni', state.C_b_G, state.v_G)
    still = np.zeros(3)  # no lever arm: the rate does not matter
    pings = [sensor.measure(k, v, still) for k, v in enumerate(v_b)]
    return (
        chosen,
        np.array([ping.velocity_m for ping in pings]),
        np.array([ping.covariance_m for ping in pings]),
    )


def _depths(
    truth: Truth, stamps: NDArray[np.int64], seed: int
) -> tuple[NDArray[np.int64], Array, float]:
    stride = round(_IMU_HZ / _DEPTH_HZ)
    chosen = stamps[stride - 1 :: stride]
    sensor = DepthSensor(DepthErrors(), stream(seed, 'leader/depth'))
    state = truth.state(chosen)
    depth = [
        sensor.measure(k, -h, C) for k, (h, C) in enumerate(zip(state.h, state.C_b_G, strict=True))
    ]
    return chosen, np.array(depth), sensor.variance


def _params(truth: Truth, first_ns: int, seed: int) -> LeaderParams:
    sigma = InitialSigma(
        *(
            default_of(LeaderParams, f'initial_sigma_{name}')
            for name in ('position', 'height', 'velocity', 'tilt_deg', 'heading_deg')
        )
    )
    initial = initial_parameters(truth.state(first_ns), sigma, stream(seed, 'leader/initial'))
    return from_mapping(
        LeaderParams,
        {
            **NO_COMMON_ERRORS,
            **NO_RESERVE,
            **initial,
            'navigation': 'own',
            'lockstep': True,
            'output_period_s': _OUTPUT_S,
        },
    )


def _drift(truth: Truth, start_ns: int, track: engine_run.Track) -> Drift:
    state = truth.state(track.stamps_ns)
    C_e_G = np.array([grid.ecef_to_grid(r_e) for r_e in state.r_e])
    dr_G = np.einsum('nij,nj->ni', C_e_G, track.r_e - state.r_e)
    P_G = np.einsum('nij,njk,nlk->nil', C_e_G, track.P[:, X.dr_e, X.dr_e], C_e_G)
    ahead = state.v_G[:, :2] / np.linalg.norm(state.v_G[:, :2], axis=1)[:, None]
    port = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    phi_G = np.array(
        [-attitude.log(C @ T.T) for C, T in zip(track.C_b_G, state.C_b_G, strict=True)]
    )
    flat = P_G[:, :2, :2]
    return Drift(
        time_s=np.asarray((track.stamps_ns - start_ns) * 1e-9, dtype=np.float64),
        along=np.einsum('ni,ni->n', ahead, dr_G[:, :2]),
        cross=np.einsum('ni,ni->n', port, dr_G[:, :2]),
        up=dr_G[:, 2],
        sigma_along=np.sqrt(np.einsum('ni,nij,nj->n', ahead, flat, ahead)),
        sigma_cross=np.sqrt(np.einsum('ni,nij,nj->n', port, flat, port)),
        nees=np.einsum('ni,ni->n', dr_G, np.linalg.solve(P_G, dr_G[:, :, None])[:, :, 0]),
        heading=phi_G[:, 2],
        sigma_heading=np.sqrt(track.P[:, 2, 2]),
    )


def main(args: Sequence[str] | None = None) -> None:
    """Print a table over seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--hours', type=float, default=2.0)
    parser.add_argument('--seeds', type=int, default=4)
    chosen = parser.parse_args(args)
    duration_s = 3600.0 * chosen.hours
    runs = [run(duration_s, seed) for seed in range(1, chosen.seeds + 1)]
    distance = SPEED * runs[0].time_s[-1]
    lines = ['seed   along m  sigma   cross m  sigma   2-D %   NEES/3  heading deg  sigma']
    for seed, r in enumerate(runs, 1):
        percent = 100.0 * math.hypot(r.along[-1], r.cross[-1]) / distance
        lines.append(
            f'{seed:4d} {r.along[-1]:9.2f} {r.sigma_along[-1]:6.2f} {r.cross[-1]:9.2f} '
            f'{r.sigma_cross[-1]:6.2f} {percent:7.3f} {r.nees[-1] / 3.0:8.2f} '
            f'{math.degrees(r.heading[-1]):12.4f} {math.degrees(r.sigma_heading[-1]):6.4f}'
        )
    e = expected(duration_s)
    rms = math.sqrt(np.mean([r.along[-1] ** 2 + r.cross[-1] ** 2 for r in runs]))
    lines += [
        f'RMS 2-D {rms:.2f} m, {100.0 * rms / distance:.3f} % of {distance / 1000.0:.2f} km; '
        f'mean NEES/3 {np.mean([r.nees[-1] for r in runs]) / 3.0:.2f}',
        f'specification: along {e.along[0]:.2f} to {e.along[1]:.2f} m, '
        f'cross {e.cross[0]:.2f} to {e.cross[1]:.2f} m (1-sigma)',
    ]
    print('\n'.join(lines))  # noqa: T201 - the output of a command


if __name__ == '__main__':
    main()
