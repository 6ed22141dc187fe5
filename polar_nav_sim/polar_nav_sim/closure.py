"""Closure error of the truth: its ideal increments, integrated by the core's strapdown.

``python -m polar_nav_sim.closure`` prints the table of docs/simulation.md: error after an hour by
mission and length of the IMU interval. Truth is the same for every length: what falls with it is
the error of the strapdown, what stays is that of the truth and rounding. Height and vertical
velocity are held at the truth's at the end of every second, as depth holds them in navigation; an
hour without that multiplies any vertical error by five hundred.
"""

from __future__ import annotations

import argparse
import sys
from typing import NamedTuple

import numpy as np

from polar_nav_core import attitude
from polar_nav_core.strapdown import Strapdown

from .mission import Mission, load_mission
from .resources import mission_names

RATES_HZ = (50.0, 100.0, 200.0)
HOLD_S = 1.0


class Closure(NamedTuple):
    """Errors at the end of a mission: position [m], velocity [m/s], attitude [rad]."""

    position_m: float
    velocity: float
    attitude: float


def closure(mission: Mission, vehicle: str, *, hold: bool = True) -> Closure:
    """Closure error of a mission: its integrated ideal increments against the truth at the end.

    Parameters
    ----------
    mission : Mission
        Its IMU rate is the rate of the strapdown.
    vehicle : str
        Vehicle of the truth.
    hold : bool
        Whether height and vertical velocity are held at the truth's every second.
    """
    trajectory = mission.truth(vehicle)
    period_s = mission.imu_period_ns * 1e-9
    stride = max(1, round(HOLD_S / period_s))
    first = trajectory.samples(0, 1).state
    ins = Strapdown(first.C_b_G[0], first.v_G[0], first.r_e[0])
    last = first
    for k0 in range(1, mission.sample_count, stride):
        block = trajectory.samples(k0, min(k0 + stride, mission.sample_count))
        ins.run(block.delta_theta_b, block.delta_v_b, period_s)
        last = block.state
        if hold:
            ins.hold_vertical(float(last.h[-1]), float(last.v_G[-1, 2]))
    turn = attitude.log(last.C_b_G[-1].T @ ins.C_b_G)
    return Closure(
        float(np.linalg.norm(ins.r_e - last.r_e[-1])),
        float(np.linalg.norm(ins.v_G - last.v_G[-1])),
        float(np.linalg.norm(turn)),
    )


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description='Closure of the truth by the strapdown.')
    parser.add_argument('missions', nargs='*', help='names or files; default: all')
    parser.add_argument('--duration-s', type=float, default=3600.0)
    names = parser.parse_args(arguments)
    out = ['mission        IMU [Hz]  position [m]  velocity [m/s]  attitude [rad]']
    for name in names.missions or mission_names():
        for rate in RATES_HZ:
            mission = load_mission(name).with_overrides(
                {'imu_rate_hz': rate, 'duration_s': names.duration_s}
            )
            c = closure(mission, mission.followers[0])
            out.append(
                f'{mission.name:14} {rate:8.0f}  {c.position_m:12.1e}  {c.velocity:14.1e}'
                f'  {c.attitude:14.1e}'
            )
    sys.stdout.write('\n'.join(out) + '\n')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
