"""Blocks of the follower's error state (docs/frames.md, docs/derivations/error_model.md).

Errors of the navigation state are estimate minus truth: ``Chat_b_G = exp(-[phi_G x]) C_b_G``,
``dv_G = vhat_G - v_G`` (as components), ``dr_e = rhat_e - r_e``. Sensor errors are truth minus
estimate, i.e. what is left in the corrected measurement: ``omega_used = omega + b_gyro_b``. The
engine corrects a state by an estimated error in one place, `kernels.sins.update.feed_back`.
"""

from __future__ import annotations

from typing import NamedTuple


class ErrorState(NamedTuple):
    """Blocks of the error vector, in order; `X` is the instance to use."""

    phi_G: slice = slice(0, 3)
    """Attitude error, grid axes [rad]."""
    dv_G: slice = slice(3, 6)
    """Velocity error, grid axes [m/s]."""
    dr_e: slice = slice(6, 9)
    """Position error, ECEF [m]."""
    b_gyro_b: slice = slice(9, 12)
    """Gyro bias left after correction, body axes [rad/s]."""
    b_accel_b: slice = slice(12, 15)
    """Accelerometer bias left after correction, body axes [m/s^2]."""
    dvl_scale_m: slice = slice(15, 18)
    """Relative scale error per DVL axis left after correction [-]."""
    dvl_markov_m: slice = slice(18, 21)
    """Slowly varying DVL velocity error left after correction, DVL axes [m/s]."""
    usbl_bias_a: slice = slice(21, 24)
    """USBL position error left after correction, array axes [m]."""

    @property
    def size(self) -> int:
        """Number of states."""
        return int(self[-1].stop)


X = ErrorState()
