"""Outputs of the engine: estimates with their statistics, and receipts of messages.

Stamps are integer nanoseconds, as those of the events.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from .. import order
from ..arrays import Array
from ..identification.result import Identification
from .verdicts import Verdict


def _nan3() -> Array:
    return np.full(3, np.nan)


@dataclass(frozen=True, slots=True)
class Receipt:
    """Verdict on one fix, or on a refused local message, with the numbers behind it."""

    stamp_ns: int
    verdict: Verdict
    reason: str
    topic: str
    source: str
    sequence: int
    validity_ns: int
    transmit_ns: int = 0
    receive_ns: int = 0
    fused_ns: int = 0
    delay_handling: str = ''
    steps_rolled_back: int = 0
    innovation_G: Array = field(default_factory=_nan3)
    innovation_variance_G: Array = field(default_factory=_nan3)
    nis: float = float('nan')
    dof: int = 0
    gate: float = float('inf')
    revision: int = 0

    @property
    def age_s(self) -> float:
        """Time from validity to reception [s]; NaN if either is not known."""
        if not (self.validity_ns and self.receive_ns):
            return float('nan')
        return (self.receive_ns - self.validity_ns) * 1e-9


LOCAL_DOF = {'dvl': 3, 'depth': 1}
"""Local sources and the degrees of freedom of one measurement; rows of local statistics."""
UPDATES, LOCAL_GATED, NIS_SUM = order.UPDATES, order.GATED, order.NIS_SUM
"""Columns of local statistics: used, refused by the gate, sum of the NIS of those used."""


def no_local_statistics() -> Array:
    """Zero local statistics, shape (2, 3): one row per entry of `LOCAL_DOF`."""
    return np.zeros((len(LOCAL_DOF), 3))


@dataclass(frozen=True)
class ModelEstimate:
    """Estimated drag of the vehicle and current of the water, with sigmas.

    Attributes
    ----------
    v_r_b, v_r_covariance_b : (3,), (3, 3) arrays
        Velocity through the water, body axes [m/s].
    current_G, current_covariance_G : (3,), (3, 3) arrays
        Velocity of the water over ground, grid axes [m/s].
    drag_linear, drag_quadratic : float
        d1x [N s/m], d2x [N s^2/m^2], each with its 1-sigma; and their correlation.
    heading_bias, heading_bias_sigma : float
        Measured minus true psi [rad].
    current_walk : float
        Density q_c in use [m^2/s^3].
    bottom_lock : bool
        Whether a DVL is in use; False in station mode, which has none.
    """

    v_r_b: Array
    v_r_covariance_b: Array
    current_G: Array
    current_covariance_G: Array
    drag_linear: float
    drag_linear_sigma: float
    drag_quadratic: float
    drag_quadratic_sigma: float
    drag_correlation: float
    heading_bias: float
    heading_bias_sigma: float
    current_walk: float
    bottom_lock: bool = False


@dataclass(frozen=True)
class Estimate:
    """State at a stamp: r_e ECEF [m], v_G [m/s], C_b_G, P (24, 24) and estimated sensor errors.

    Where there is no SINS (station mode), ``P`` is NaN outside of attitude, velocity and position,
    and so are the sensor errors. ``model`` is there when the vehicle's model takes part.
    ``local_statistics``, shape (2, 3), is of the local measurements since the estimate before:
    rows dvl and depth, columns `UPDATES`, `LOCAL_GATED`, `NIS_SUM`.
    """

    stamp_ns: int
    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    gyro_bias_b: Array
    accel_bias_b: Array
    dvl_scale_m: Array
    dvl_markov_m: Array
    usbl_bias_a: Array
    fixes_received: int
    fixes_fused: int
    last_validity_ns: int
    local_statistics: Array = field(default_factory=no_local_statistics)
    model: ModelEstimate | None = None


Output: TypeAlias = Estimate | Receipt | Identification
