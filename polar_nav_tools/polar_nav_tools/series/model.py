"""Vehicle model and water as arrays, estimated or true; axes and stamps as in `series.vehicle`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polar_nav_core.identification.result import Identification

from .vehicle import Floats, Ints, Series


@dataclass(frozen=True, eq=False)
class ModelSeries(Series):
    """`<vehicle>/nav/model` or `truth/model` (polar_nav_msgs/VehicleModel), N samples.

    Attributes
    ----------
    stamp_ns : ndarray of int64, shape (N,)
        Time of validity [ns].
    v_r_b, P_v_r_b : ndarray, shapes (N, 3), (N, 3, 3)
        Velocity through the water, body axes [m/s].
    current_G, P_current_G : ndarray, shapes (N, 3), (N, 3, 3)
        Velocity of the water over ground, grid axes [m/s].
    drag_linear, drag_quadratic, with sigma, and drag_correlation : ndarray, shape (N,)
        d1x [N s/m], d2x [N s^2/m^2].
    heading_bias, heading_bias_sigma : ndarray, shape (N,)
        Measured minus true psi [rad].
    current_walk : ndarray, shape (N,)
        Density q_c in use [m^2/s^3].
    """

    stamp_ns: Ints
    v_r_b: Floats
    P_v_r_b: Floats
    current_G: Floats
    P_current_G: Floats
    drag_linear: Floats
    drag_linear_sigma: Floats
    drag_quadratic: Floats
    drag_quadratic_sigma: Floats
    drag_correlation: Floats
    heading_bias: Floats
    heading_bias_sigma: Floats
    current_walk: Floats


@dataclass(frozen=True)
class Identified:
    """One `<vehicle>/nav/identification` (polar_nav_msgs/Identification).

    Attributes
    ----------
    stamp_ns : int
        Stamp in the order of events [ns].
    values, sigmas : dict of str to float
        By the name of the parameter, SI units.
    """

    stamp_ns: int
    method: str
    verdict: str
    reason: str
    trigger: str
    fixes: int
    values: dict[str, float]
    sigmas: dict[str, float]
    condition_number: float
    cost: float
    iterations: int


@dataclass(frozen=True, eq=False)
class ModelRun:
    """Estimates of drag and current of one run, and their truth if it is known."""

    estimated: ModelSeries
    identified: tuple[Identified, ...] = ()
    truth: ModelSeries | None = None


def identified_of_engine(i: Identification) -> Identified:
    """Identification of the engine in the form of a recorded message."""
    variances = np.diagonal(np.asarray(i.covariance, dtype=np.float64))
    sigmas = np.sqrt(np.where(variances >= 0.0, variances, np.nan))
    if len(sigmas) != len(i.names):
        sigmas = np.full(len(i.names), np.nan)
    return Identified(
        stamp_ns=i.stamp_ns,
        method=i.method,
        verdict=i.verdict.name,
        reason=i.reason,
        trigger=i.trigger,
        fixes=i.fixes,
        values=dict(zip(i.names, np.asarray(i.values, dtype=np.float64).tolist(), strict=False)),
        sigmas=dict(zip(i.names, sigmas.tolist(), strict=False)),
        condition_number=i.condition_number,
        cost=i.cost,
        iterations=i.iterations,
    )
