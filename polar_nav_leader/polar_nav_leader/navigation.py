"""The leader's own navigation: the engine, and its estimates as states of the leader. No ROS."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from polar_nav_core import grid
from polar_nav_core.arrays import Array
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, Event, ImuSample
from polar_nav_core.engine.outputs import Estimate, Output
from polar_nav_core.error_model import X

from .params import LeaderParams
from .states import LeaderState


class LeaderEngine(Engine):
    """Engine with the angular rate at its newest epoch, which no estimate contains.

    States between estimates are interpolated with their rates (`states.py`).

    Parameters
    ----------
    params : LeaderParams
    imu_lever_b : sequence of float
        IMU from base_link, body axes [m].
    """

    def __init__(
        self, params: LeaderParams, imu_lever_b: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> None:
        super().__init__(params, imu_lever_b=imu_lever_b)
        self._means = params.imu_sample == 'mean'
        self._before: ImuSample | None = None
        self._newest: ImuSample | None = None
        self.restarts = 0

    def process(self, event: Event) -> Iterator[Output]:
        """Process the next event of the total order."""
        # The estimate that is due before this event comes first: it belongs to the sample before.
        yield from super().process(event)
        if isinstance(event, ImuSample):
            self._before, self._newest = self._newest, event
        elif isinstance(event, Command):
            self.restarts += 1

    def omega_ib_b(self) -> Array:
        """Rate at the newest IMU stamp, body axes [rad/s], shape (3,), bias included.

        A mean over an interval belongs to its middle, so the last two means are carried on by half
        an interval.
        """
        if self._newest is None:
            return np.full(3, np.nan)
        if self._before is None or not self._means:
            return self._newest.omega_ib_b
        return np.asarray(1.5 * self._newest.omega_ib_b - 0.5 * self._before.omega_ib_b)


def state_of(e: Estimate, omega_ib_b: Array) -> LeaderState:
    """State of the leader of an estimate.

    Parameters
    ----------
    e : Estimate
        Estimate of the engine.
    omega_ib_b : ndarray, shape (3,)
        Rate at its stamp as measured [rad/s].
    """
    C_e_G = grid.ecef_to_grid(e.r_e)
    C_G_e = C_e_G.T
    return LeaderState(
        stamp_ns=e.stamp_ns,
        r_e=e.r_e,
        v_e=C_G_e @ e.v_G,
        C_b_e=C_G_e @ e.C_b_G,
        omega_eb_b=omega_ib_b - e.gyro_bias_b - e.C_b_G.T @ grid.earth_rate(e.r_e),
        P_r_e=e.P[X.dr_e, X.dr_e],
        P_phi_e=C_G_e @ e.P[X.phi_G, X.phi_G] @ C_e_G,
        P_v_e=C_G_e @ e.P[X.dv_G, X.dv_G] @ C_e_G,
    )
