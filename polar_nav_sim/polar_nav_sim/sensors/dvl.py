"""DVL error model: velocity of the instrument over ground, ping by ping.

With v_m the true velocity of the instrument in its own axes, per axis:

    y = (c_i / c) (1 + scale) v_m + bias + markov_k + sigma w_k

c_i is the sound speed that the instrument assumes, c that of the water at its depth: the Doppler
shift is 2 f v / c. The horizontal part of a phased array does not depend on c.

The four-beam option measures along beams instead (:mod:`polar_nav_sim.sensors.janus`),

    s_i = b_i . ((1 + scale) v_m + bias + markov_k) + sigma_beam w_ik

and y is their least-squares velocity. A beam is lost with a stated probability; all are lost out
of the range of altitudes, with four beams each where its own slant range is out of the ranges that
these altitudes have on a level vehicle. With fewer than three beams a ping is invalid: it is given
out, marked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.attitude import exp, matrix_from_euler
from polar_nav_core.engine.events import LEAST_BEAMS
from polar_nav_core.params import flag, param, sigma, vector

from ..randomness import substream
from ..section import Spec
from ..sound_speed import SoundSpeed
from .janus import BEAMS, BeamData, directions, slant_ranges, solve
from .noise import CHUNK, Draws, GaussMarkov, Index

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Mounting(Spec):
    """Position and orientation of an instrument on the vehicle."""

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
    scale_sigma: float = sigma(
        0.0, '', 0.5, '1-sigma of a further constant scale factor error, drawn per run'
    )
    bias: tuple[float, ...] = vector((0.0, 0.0, 0.0), 'm/s', -1.0, 1.0, 'Constant error per axis')
    markov_sigma: float = sigma(
        0.005, 'm/s', 1.0, '1-sigma of the slowly varying error per axis (Gauss-Markov)'
    )
    markov_tau_s: float = param(300.0, 's', 0.1, 1e6, 'Its correlation time')
    noise_sigma: float = param(0.005, 'm/s', 0.0, 1.0, 'White noise per axis and ping, 1-sigma')
    beam_loss_probability: float = param(0.0, '', 0.0, 1.0, 'Probability of a lost beam in a ping')
    min_altitude_m: float = param(0.3, 'm', 0.0, 100.0, 'No bottom lock nearer to the sea floor')
    max_altitude_m: float = param(200.0, 'm', 0.1, 12000.0, 'No bottom lock farther from it')
    four_beams: bool = flag(
        False, 'Measure along four beams; the velocity is their least-squares solution'
    )
    beam_angle_deg: float = param(
        30.0, 'deg', 1.0, 60.0, 'Of each beam against the downward axis (four beams)'
    )
    beam_azimuth_deg: float = param(
        45.0, 'deg', -360.0, 360.0, 'Of the first beam from x towards y (four beams)'
    )
    beam_noise_sigma: float = param(
        0.005, 'm/s', 0.0, 1.0, 'White noise along a beam, in place of noise_sigma (four beams)'
    )
    beam_range_sigma_m: float = param(
        0.05, 'm', 0.0, 100.0, 'White noise of the range along a beam (four beams)'
    )
    misalignment_sigma_deg: float = sigma(
        0.0, 'deg', 90.0, '1-sigma about each axis of a wrong mounting, drawn per run'
    )
    lever_sigma_m: float = sigma(
        0.0, 'm', 10.0, '1-sigma of a wrong position along each axis, drawn per run'
    )
    latency_s: float = param(
        0.0, 's', 0.0, 10.0, 'Sent, and stamped, so much later than the velocity was valid'
    )
    assumed_sound_speed: float = param(
        0.0, 'm/s', 0.0, 1700.0, 'Sound speed the instrument assumes; 0: that of the water'
    )
    phased_array: bool = flag(False, 'The horizontal velocity does not depend on sound speed')
    bad_ping_probability: float = param(
        0.0, '', 0.0, 1.0, 'Probability that a ping, not marked, is off by more than its noise'
    )
    bad_ping_sigma: float = param(0.5, 'm/s', 0.0, 10.0, '1-sigma per axis of these errors')


@dataclass(frozen=True)
class Ping:
    """Reading of one ping.

    Attributes
    ----------
    velocity_m : ndarray, shape (3,)
        Instrument axes [m/s]; NaN if invalid.
    covariance_m : ndarray, shape (3, 3)
        Of its white part [(m/s)^2]; NaN if invalid.
    beams : int
        Number of good beams.
    altitude : float
        Above the sea floor [m]; NaN where unknown or without lock.
    beam_data : BeamData or None
        Reading of each beam; None without the four-beam option.
    """

    velocity_m: Floats
    covariance_m: Floats
    beams: int
    altitude: float
    beam_data: BeamData | None = None

    @property
    def valid(self) -> bool:
        """Whether there is a velocity."""
        return self.beams >= LEAST_BEAMS


class DvlSensor:
    """One DVL.

    Parameters
    ----------
    errors : DvlErrors
        Its errors and mounting.
    period_s : float
        Time between pings [s].
    rng : numpy.random.Generator
        Its own stream.
    water : SoundSpeed, optional
        Sound speed around it; only an instrument that assumes another one needs it.
    """

    def __init__(
        self,
        errors: DvlErrors,
        period_s: float,
        rng: np.random.Generator,
        water: SoundSpeed | None = None,
    ) -> None:
        if errors.assumed_sound_speed > 0.0 and water is None:
            raise ValueError('a DVL that assumes a sound speed needs that of the water')
        self._e = errors
        self._water = water
        self._arm_b = errors.arm_b
        self._C_m_b = errors.C_s_b
        if errors.lever_sigma_m > 0.0:
            unit = substream(rng, 'lever').standard_normal(3)
            self._arm_b = self._arm_b + errors.lever_sigma_m * unit
        if errors.misalignment_sigma_deg > 0.0:
            unit = substream(rng, 'misalignment').standard_normal(3)
            turn = math.radians(errors.misalignment_sigma_deg) * unit
            self._C_m_b = np.asarray(self._C_m_b @ exp(turn))
        self._scale = 1.0 + np.array(errors.scale)
        self._bias = np.array(errors.bias)
        self._markov = GaussMarkov(
            np.full(3, errors.markov_sigma), errors.markov_tau_s, period_s, rng.standard_normal(3)
        )
        # 3 white, 3 of the process, 4 beams (compared with a quantile of the normal distribution).
        self._draws = Draws(rng, 6 + BEAMS)
        self._slow = np.empty((0, 3))
        # Streams of their own: the options change no other draw.
        beam_rng, scale_rng = rng.spawn(2)
        self._beam_draws = Draws(beam_rng, 2 * BEAMS)
        self._scale = self._scale + errors.scale_sigma * scale_rng.standard_normal(3)
        self._bad = Draws(substream(rng, 'bad/when'), 1, uniform=True)
        self._off = Draws(substream(rng, 'bad/off'), 3)
        angle = math.radians(errors.beam_angle_deg)
        self._b_m = directions(angle, math.radians(errors.beam_azimuth_deg))
        self._level = math.cos(angle)
        self._index = Index()

    def measure(
        self,
        k: int,
        v_b: Floats,
        omega_eb_b: Floats,
        altitude: float = math.nan,
        C_b_G: Floats | None = None,
        depth: float = 0.0,
    ) -> Ping:
        """Reading of ping number k.

        Parameters
        ----------
        k : int
            Numbers never go back; skipped ones are skipped in the noise.
        v_b : ndarray, shape (3,)
            Velocity of base_link over ground, body axes [m/s].
        omega_eb_b : ndarray, shape (3,)
            Angular rate against the earth, body axes [rad/s].
        altitude : float
            Of base_link above the sea floor [m]; NaN: unknown, the bottom is then assumed in
            reach.
        C_b_G : ndarray, shape (3, 3), optional
            Body to grid, for the slant ranges of the four-beam option; level if not given.
        depth : float
            Of base_link [m], for the sound speed of the water.
        """
        self._index.take(k, 1)
        chunk, row = divmod(k, CHUNK)
        while self._draws.chunk < chunk:
            self._slow = self._markov.advance(self._draws.advance()[:, 3:6])
            self._beam_draws.advance()
            self._bad.advance()
            self._off.advance()
        w = self._draws.rows[row]
        # Phi(w) is uniform: a beam lives where it is above the probability of loss.
        uniform = np.array([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in w[6:]])
        alive = uniform >= self._e.beam_loss_probability
        v_m = self._C_m_b.T @ (v_b + np.cross(omega_eb_b, self._arm_b))
        if self._e.assumed_sound_speed > 0.0:
            v_m = self._doppler(depth) * v_m
        slow_m = self._scale * v_m + self._bias + self._slow[row]
        if 0.5 * (self._bad.rows[row, 0] + 1.0) < self._e.bad_ping_probability:
            slow_m = slow_m + self._e.bad_ping_sigma * self._off.rows[row]
        if self._e.four_beams:
            C_b_G = np.eye(3) if C_b_G is None else C_b_G
            return self._along_beams(slow_m, alive, altitude, C_b_G, self._beam_draws.rows[row])
        reach = not (altitude < self._e.min_altitude_m or altitude > self._e.max_altitude_m)
        beams = int(np.count_nonzero(alive)) if reach else 0
        altitude = altitude if reach else math.nan
        if beams < LEAST_BEAMS:
            return Ping(np.full(3, math.nan), np.full((3, 3), math.nan), beams, altitude)
        sigma = self._e.noise_sigma
        return Ping(slow_m + sigma * w[:3], sigma**2 * np.eye(3), beams, altitude)

    def sound_speed(self, depth: float) -> float:
        """Sound speed assumed by the instrument at a depth [m/s]; NaN if it assumes none."""
        if self._e.assumed_sound_speed > 0.0 or self._water is None:
            return self._e.assumed_sound_speed or math.nan
        return self._water.at(depth)

    def _doppler(self, depth: float) -> Floats:
        """Factor c_i / c of each axis, shape (3,)."""
        assert self._water is not None  # as __init__ has it
        ratio = self._e.assumed_sound_speed / self._water.at(depth)
        level = 1.0 if self._e.phased_array else ratio
        return np.array([level, level, ratio])

    def _along_beams(
        self, slow_m: Floats, alive: Bools, altitude: float, C_b_G: Floats, w: Floats
    ) -> Ping:
        e = self._e
        C_m_G = C_b_G @ self._C_m_b
        height = altitude + float(C_b_G[2] @ self._arm_b)
        ranges = slant_ranges(self._b_m, C_m_G, height)
        # Slant ranges that the limits of altitude have on a level vehicle; NaN is in reach.
        near, far = e.min_altitude_m / self._level, e.max_altitude_m / self._level
        good = alive & ~(ranges < near) & ~(ranges > far)
        along = np.where(good, self._b_m @ slow_m + e.beam_noise_sigma * w[:BEAMS], math.nan)
        ranges = np.where(good, ranges + e.beam_range_sigma_m * w[BEAMS:], math.nan)
        beams = int(np.count_nonzero(good))
        data = BeamData(
            self._b_m, good, along, e.beam_noise_sigma**2, ranges, e.beam_range_sigma_m**2
        )
        below = ranges * -(self._b_m @ C_m_G[2])
        altitude_m = float(np.mean(below[good])) if beams > 0 else math.nan
        if beams < LEAST_BEAMS:
            return Ping(np.full(3, math.nan), np.full((3, 3), math.nan), beams, altitude_m, data)
        v_m, cofactor = solve(self._b_m, along, good)
        return Ping(v_m, e.beam_noise_sigma**2 * cofactor, beams, altitude_m, data)
