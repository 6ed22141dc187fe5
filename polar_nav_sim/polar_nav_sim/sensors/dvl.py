"""DVL error model: velocity of the instrument over ground, ping by ping.

With v_m the true velocity of the instrument in its own axes, per axis:

    y = (1 + scale) v_m + bias + markov_k + sigma w_k

A beam is lost with a stated probability, all of them out of the range of altitudes; with fewer
than three beams a ping is invalid: it is given out, marked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.params import param, vector

from ..specs import Spec
from .noise import CHUNK, Draws, GaussMarkov, Index

Floats = NDArray[np.float64]

BEAMS = 4
LEAST_BEAMS = 3


@dataclass(frozen=True)
class Mounting(Spec):
    """Where an instrument sits on the vehicle."""

    lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -100.0, 100.0, 'Position from base_link, body axes'
    )
    rpy_deg: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0),
        'deg',
        -360.0,
        360.0,
        'Roll, pitch, yaw of the instrument axes in body axes',
    )

    @property
    def arm_b(self) -> Floats:
        """Lever arm, shape (3,) [m]."""
        return np.array(self.lever_b)

    @property
    def C_s_b(self) -> Floats:
        """Instrument axes to body axes, shape (3, 3)."""
        roll, pitch, yaw = np.radians(self.rpy_deg)
        return matrix_from_euler(yaw, pitch, roll)


@dataclass(frozen=True)
class DvlErrors(Mounting):
    """Errors of a DVL; defaults are those of polar cooperative navigation, section 6.1.

    The paper has no white noise; 0.005 m/s per ping is ours.
    """

    scale: tuple[float, ...] = vector(
        (1e-4, 1e-4, 1e-4), '', -0.5, 0.5, 'Scale factor error per axis'
    )
    bias: tuple[float, ...] = vector((0.0, 0.0, 0.0), 'm/s', -1.0, 1.0, 'Constant error per axis')
    markov_sigma: float = param(
        0.005, 'm/s', 0.0, 1.0, '1-sigma of the slowly varying error per axis (Gauss-Markov)'
    )
    markov_tau_s: float = param(300.0, 's', 0.1, 1e6, 'Its correlation time')
    noise_sigma: float = param(0.005, 'm/s', 0.0, 1.0, 'White noise per axis and ping, 1-sigma')
    beam_loss_probability: float = param(0.0, '', 0.0, 1.0, 'That a beam gives nothing in a ping')
    min_altitude_m: float = param(0.3, 'm', 0.0, 100.0, 'No bottom lock nearer to the sea floor')
    max_altitude_m: float = param(200.0, 'm', 0.1, 12000.0, 'No bottom lock farther from it')


@dataclass(frozen=True)
class Ping:
    """What the instrument says.

    Attributes
    ----------
    velocity_m : ndarray, shape (3,)
        Instrument axes [m/s]; NaN if invalid.
    variance : float
        Of each component, white part [(m/s)^2].
    beams : int
        Beams that gave something.
    altitude : float
        Above the sea floor [m]; NaN where unknown or without lock.
    """

    velocity_m: Floats
    variance: float
    beams: int
    altitude: float

    @property
    def valid(self) -> bool:
        """Whether there is a velocity."""
        return self.beams >= LEAST_BEAMS


class DvlSensor:
    """One DVL.

    Parameters
    ----------
    errors : DvlErrors
        What is wrong with it, and how it is mounted.
    period_s : float
        Time between pings [s].
    rng : numpy.random.Generator
        Its own stream.
    """

    def __init__(self, errors: DvlErrors, period_s: float, rng: np.random.Generator) -> None:
        self._e = errors
        self._arm_b = errors.arm_b
        self._C_m_b = errors.C_s_b
        self._scale = 1.0 + np.array(errors.scale)
        self._bias = np.array(errors.bias)
        self._markov = GaussMarkov(
            np.full(3, errors.markov_sigma), errors.markov_tau_s, period_s, rng.standard_normal(3)
        )
        # 3 white, 3 of the process, 4 beams (compared with a quantile of the normal distribution).
        self._draws = Draws(rng, 6 + BEAMS)
        self._slow = np.empty((0, 3))
        self._index = Index()

    def measure(self, k: int, v_b: Floats, omega_eb_b: Floats, altitude: float = math.nan) -> Ping:
        """Ping number k.

        Parameters
        ----------
        k : int
            Numbers never go back; skipped ones are skipped in the noise.
        v_b : ndarray, shape (3,)
            Velocity of base_link over ground, body axes [m/s].
        omega_eb_b : ndarray, shape (3,)
            Angular rate against the earth, body axes [rad/s].
        altitude : float
            Above the sea floor [m]; NaN: unknown, the bottom is then taken to be in reach.
        """
        self._index.take(k, 1)
        chunk, row = divmod(k, CHUNK)
        while self._draws.chunk < chunk:
            self._slow = self._markov.advance(self._draws.advance()[:, 3:6])
        w = self._draws.rows[row]
        reach = not (altitude < self._e.min_altitude_m or altitude > self._e.max_altitude_m)
        beams = 0
        if reach:
            # Phi(w) is uniform: a beam lives where it is above the probability of loss.
            uniform = [0.5 * math.erfc(-x / math.sqrt(2.0)) for x in w[6:]]
            beams = sum(u >= self._e.beam_loss_probability for u in uniform)
        if beams < LEAST_BEAMS:
            nothing = np.full(3, math.nan)
            return Ping(nothing, math.nan, beams, altitude if reach else math.nan)
        v_m = self._C_m_b.T @ (v_b + np.cross(omega_eb_b, self._arm_b))
        velocity_m = self._scale * v_m + self._bias + self._slow[row] + self._e.noise_sigma * w[:3]
        return Ping(velocity_m, self._e.noise_sigma**2, beams, altitude)
