"""Example input of a report: a made-up mission with every kind of fix.

    python -m polar_nav_tools.report.example report.html --latitude 89.995

Errors are Gauss-Markov processes with the covariance that is claimed for them; the configuration
that ignores the delay lags by speed x delay and claims the same covariance. Nothing here is a
filter, and no figure a result.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.attitude import euler_from_matrix, exp, matrix_from_euler
from polar_nav_core.earth import ecef_from_geodetic, geodetic_from_ecef
from polar_nav_core.grid import TRUE_HEADING_SIGMA_CAP, convergence, ecef_to_grid

from ..scoring import Balance
from ..series.vehicle import (
    SENSOR_ERRORS,
    SENSOR_SIGMAS,
    EstimateSeries,
    ReceiptRecord,
    TruthSeries,
)
from .example_fixes import RATE, START_NS, as_ignored, late_fixes
from .graticule import angle_label
from .input import Digest, ReportInput, TopicCount

Floats = NDArray[np.float64]

ARCMIN = np.pi / 10800.0


def example_input(
    *,
    latitude_deg: float = 80.0,
    longitude_deg: float = 120.0,
    minutes: float = 10.0,
    seed: int = 1,
) -> ReportInput:
    """Two configurations on one mission.

    Parameters
    ----------
    latitude_deg, longitude_deg : float
        Start of the follower [deg].
    minutes : float
        Duration of the mission.
    seed : int
        Seed of all random numbers.
    """
    rng = np.random.default_rng(seed)
    truth = example_truth('follower', latitude_deg, longitude_deg, minutes)
    leader = example_truth('leader', latitude_deg, longitude_deg, minutes, offset=(150.0, 260.0))
    fixes, receipts, sent, lag_s = late_fixes(truth, rng)
    aware = _estimate(truth, 'modified_akf', rng, np.zeros(len(truth)), receipts)
    naive = _estimate(truth, 'conventional_akf', rng, lag_s, receipts)
    late = [as_ignored(r, truth, lag_s, rng) for r in receipts]
    arrived = len(receipts)
    digest = hashlib.sha256(aware.r_e.tobytes()).hexdigest()
    samples = minutes * 60.0
    return ReportInput(
        title='Example mission',
        subtitle=(
            f'{minutes:g} minutes from {angle_label(latitude_deg, "NS")}, '
            f'{angle_label(longitude_deg, "EW")} at 3 m/s; '
            'a made-up run that shows every picture and is no result.'
        ),
        runs={
            'conventional_akf': (truth, naive, late),
            'modified_akf': (truth, aware, receipts),
        },
        leader=leader,
        fixes=fixes,
        sent=sent,
        counts=[
            TopicCount('/follower/imu/data_raw', *[int(samples * 100)] * 3),
            TopicCount('/follower/dvl/data', *[int(samples * 5)] * 3),
            TopicCount('/follower/depth/data', *[int(samples * 10)] * 3),
            TopicCount('/follower/acomms/rx', *[arrived] * 3),
            TopicCount('/follower/nav/state', int(samples * 10), int(samples * 10), None),
        ],
        balances=[Balance('/follower/acomms/rx', arrived, arrived)],
        digests=[Digest('nav/state and nav/receipt', digest, digest)],
        metadata={
            'mission': {'name': 'example', 'duration_s': samples, 'speed': 3.0, 'depth': 100.0},
            'seeds': {'run': seed, 'follower/imu': 11, 'leader/usbl': 12, 'acoustic_link': 13},
        },
        made='made by polar_nav_tools.report.example',
    )


def example_truth(
    vehicle: str,
    latitude_deg: float,
    longitude_deg: float,
    minutes: float,
    offset: tuple[float, float] = (0.0, 0.0),
) -> TruthSeries:
    """Truth of a slow S-bend at 3 m/s, 100 m deep; `offset` moves the start in grid axes [m]."""
    n = int(minutes * 60 * RATE) + 1
    t = np.arange(n) / RATE
    course = np.deg2rad(35.0) + 0.7 * np.sin(2.0 * np.pi * t / t[-1])  # of v_G from grid east
    v_G = 3.0 * np.stack([np.cos(course), np.sin(course), np.zeros(n)], axis=1)
    r_e = np.empty((n, 3))
    start = ecef_from_geodetic(np.deg2rad(latitude_deg), np.deg2rad(longitude_deg), -100.0)
    r_e[0] = start + ecef_to_grid(start).T @ np.array([*offset, 0.0])
    for k in range(n - 1):
        middle_G = 0.5 * (v_G[k] + v_G[k + 1]) / RATE
        half = r_e[k] + 0.5 * ecef_to_grid(r_e[k]).T @ middle_G
        r_e[k + 1] = r_e[k] + ecef_to_grid(half).T @ middle_G
    wave = 2.0 * np.pi * t
    C_b_G = matrix_from_euler(
        course + np.deg2rad(3.0) * np.sin(wave / 7.0),
        np.deg2rad(4.0) * np.sin(wave / 3.0),
        np.deg2rad(5.0) * np.sin(wave / 5.0),
    )
    latitude, longitude, height = geodetic_from_ecef(r_e)
    zeros = np.zeros((n, 3))
    return TruthSeries(
        vehicle=vehicle,
        stamp_ns=START_NS + np.arange(n) * (1_000_000_000 // RATE),
        sequence=np.arange(n),
        r_e=r_e,
        latitude=latitude,
        longitude=longitude,
        height=height,
        depth=-height,
        altitude=np.full(n, np.nan),
        v_G=v_G,
        C_b_G=C_b_G,
        omega_ib_b=zeros,
        f_b=zeros,
        current_G=zeros,
    )


def _markov(rng: np.random.Generator, n: int, sigma: Floats, tau: float) -> Floats:
    """First-order Gauss-Markov processes, shape (n, 3), stationary with this sigma each."""
    keep = np.exp(-1.0 / (RATE * tau))
    x = np.empty((n, len(sigma)))
    x[0] = rng.standard_normal(len(sigma))
    kicks = np.sqrt(1.0 - keep * keep) * rng.standard_normal((n, len(sigma)))
    for k in range(1, n):
        x[k] = keep * x[k - 1] + kicks[k]
    return x * sigma


def _estimate(
    truth: TruthSeries,
    configuration: str,
    rng: np.random.Generator,
    lag_s: Floats,
    receipts: list[ReceiptRecord],
) -> EstimateSeries:
    """Estimates with decaying start errors, consistent with their covariance but for the lag."""
    n = len(truth)
    t = np.arange(n) / RATE
    settle = 1.0 + 12.0 * np.exp(-t / 12.0)
    slow = 1.0 + 4.0 * np.exp(-t / 90.0)
    sigma_r = settle[:, None] * np.array([0.35, 0.35, 0.08])
    sigma_v = np.sqrt(settle)[:, None] * np.array([0.004, 0.004, 0.002])
    sigma_phi = np.stack([0.03 * settle, 0.03 * settle, 1.2 * slow], axis=1) * ARCMIN
    return estimate_with_errors(
        truth,
        configuration,
        dr_G=_markov(rng, n, np.ones(3), 8.0) * sigma_r - truth.v_G * lag_s[:, None],
        dv_G=_markov(rng, n, np.ones(3), 20.0) * sigma_v,
        phi_G=_markov(rng, n, np.ones(3), 60.0) * sigma_phi,
        sigma_r=sigma_r,
        sigma_v=sigma_v,
        sigma_phi=sigma_phi,
        receipts=receipts,
        local_statistics=_local_statistics(n),
    )


def _local_statistics(n: int) -> Floats:
    """Local statistics of DVL pings every second interval and depths in each; shape (n, 2, 3)."""
    rng = np.random.default_rng(7)
    pings = np.arange(n) % 2.0
    out = np.zeros((n, 2, 3))
    out[:, 0, 0], out[:, 0, 2] = pings, pings * rng.chisquare(3, n)
    out[:, 1, 0], out[:, 1, 2] = 1.0, rng.chisquare(1, n)
    return out


def estimate_with_errors(
    truth: TruthSeries,
    configuration: str,
    *,
    dr_G: Floats,
    dv_G: Floats,
    phi_G: Floats,
    sigma_r: Floats,
    sigma_v: Floats,
    sigma_phi: Floats,
    receipts: Sequence[ReceiptRecord] = (),
    local_statistics: Floats | None = None,
) -> EstimateSeries:
    """Estimates at the truth's stamps with given errors, all of shape (n, 3), grid axes.

    rhat = r + C_G_e dr_G, vhat = v + dv_G, Chat = exp(-[phi x]) C; covariances are diagonal.
    Without `local_statistics` no DVL and no depth was used.
    """
    n = len(truth)
    r_e = truth.r_e + np.einsum('nji,nj->ni', ecef_to_grid(truth.r_e), dr_G)
    C_b_G = exp(-phi_G) @ truth.C_b_G
    latitude, longitude, height = geodetic_from_ecef(r_e)
    psi, pitch, roll = euler_from_matrix(C_b_G)
    sigma_conv = convergence(latitude, longitude)
    stamp_ns = truth.stamp_ns
    fused = [r for r in receipts if r.verdict_text == 'FUSED']
    fused_ns = np.array([r.stamp_ns for r in fused], dtype=np.int64)
    received_ns = np.array([r.stamp_ns for r in receipts], dtype=np.int64)
    count = np.searchsorted(fused_ns, stamp_ns, side='right')
    age = np.full(n, np.nan)
    if fused:
        newest = np.maximum.accumulate([r.validity_ns or 0 for r in fused])
        since = (stamp_ns - newest[np.maximum(count - 1, 0)]) * 1e-9
        age = np.where(count > 0, since, np.nan)
    true_north = np.maximum(np.hypot(r_e[:, 0], r_e[:, 1]), 1e-3)
    heading_sigma = np.hypot(sigma_phi[:, 2], sigma_r[:, 0] / true_north)
    known = heading_sigma < TRUE_HEADING_SIGMA_CAP
    return EstimateSeries(
        vehicle=truth.vehicle,
        configuration=configuration,
        configurations=(configuration,),
        stamp_ns=stamp_ns,
        status=np.ones(n, dtype=np.uint8),
        r_e=r_e,
        latitude=latitude,
        longitude=longitude,
        height=height,
        depth=-height,
        v_G=truth.v_G + dv_G,
        C_b_G=C_b_G,
        roll=roll,
        pitch=pitch,
        grid_heading=np.mod(0.5 * np.pi - psi, 2.0 * np.pi),
        true_heading=np.where(known, np.mod(0.5 * np.pi - psi + sigma_conv, 2.0 * np.pi), np.nan),
        true_heading_sigma=np.minimum(heading_sigma, TRUE_HEADING_SIGMA_CAP),
        convergence=np.where(known, sigma_conv, np.nan),
        P_position_G=_diagonal(sigma_r),
        P_velocity_G=_diagonal(sigma_v),
        P_attitude_G=_diagonal(sigma_phi),
        **dict.fromkeys((*SENSOR_ERRORS, *SENSOR_SIGMAS), np.zeros((n, 3))),
        fixes_received=np.searchsorted(received_ns, stamp_ns, side='right'),
        fixes_fused=count,
        age_of_last_fix=age,
        local_statistics=np.zeros((n, 2, 3)) if local_statistics is None else local_statistics,
    )


def _diagonal(sigma: Floats) -> Floats:
    return sigma[:, :, None] * sigma[:, None, :] * np.eye(3)


def main() -> int:
    """Write the example to a file."""
    from .write import write_report

    parser = argparse.ArgumentParser(description='Write a report of a made-up mission.')
    parser.add_argument('file', type=Path)
    parser.add_argument('--latitude', type=float, default=80.0, help='of the start [deg]')
    parser.add_argument('--longitude', type=float, default=120.0, help='of the start [deg]')
    parser.add_argument('--minutes', type=float, default=10.0)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    write_report(
        args.file,
        example_input(
            latitude_deg=args.latitude,
            longitude_deg=args.longitude,
            minutes=args.minutes,
            seed=args.seed,
        ),
    )
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
