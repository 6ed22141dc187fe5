"""Strapdown state and error covariance of the follower at one stamp, in closed loop.

Events come in order. An IMU sample moves the state; when it ends a covariance step, the covariance
follows. A measurement corrects the state at once, with the covariance of the last step at or
before it: steps are never split.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from ... import attitude, earth, grid
from ...errors import FilterDivergence
from ...kernels import filter as kf
from ...kernels import filter_clone as kc
from ...kernels import filter_imu, filter_rows, filter_walk
from ..events import Array, DepthSample, DvlPing, ImuSample, InitialState
from ..params import EngineParams
from .history import History
from .noise import StatedNoise

_ARRAYS = (
    'C_b_G',
    'v_G',
    'r_e',
    'b_gyro_b',
    'b_accel_b',
    'dvl_scale_m',
    'dvl_markov_m',
    'usbl_bias_a',
    'P',
    'omega_ib_b',
    '_increments',
    '_sums',
)
_VALUES = ('stamp_ns', '_boundary_ns', '_previous_dt', '_previous_sample')
"""What a snapshot holds; everything else follows from it or is scratch."""
_MARKOV = slice(18, 21)
_USBL = slice(21, 24)


Used = tuple[Array, Array, Array, Array, Array]
"""What an update used and gave: x, K, S, L, R."""


@dataclass(frozen=True)
class Outcome:
    """What one update did: innovation (estimate minus measurement), variance, NIS and gate."""

    fused: bool
    z: Array
    variance: Array
    nis: float
    dof: int
    gate: float


class NavigationFilter:
    """The follower's navigation and its uncertainty.

    Parameters
    ----------
    params : EngineParams
        Sensors, noise, periods.
    initial : InitialState
        State and its 1-sigma values.
    stamp_ns : int
        When that holds.
    """

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        self._p = params
        self._gate_probability = params.resolved().gate_probability
        self._step_ns = round(params.filter_period_s * 1e9)
        self.stamp_ns = stamp_ns
        self._boundary_ns = stamp_ns
        self._previous_dt = 0.0
        self._previous_sample: ImuSample | None = None
        self.omega_ib_b = np.zeros(3)
        self._increments = np.zeros((4, 3))
        self._sums = np.zeros((6, 3))
        self._set_state(initial)
        self._allocate()
        self._process_noise_of: dict[float, Array] = {}
        self.last_q = np.zeros(kf.N)
        self.history = History(params.history_s, 0.004, params.filter_period_s, 40.0)
        self._locate()
        self.history.add_epoch(stamp_ns, self.point_e, self.velocity_e, self.lever_G)

    def _set_state(self, s: InitialState) -> None:
        p = self._p
        self.r_e = np.ascontiguousarray(
            earth.ecef_from_geodetic(s.latitude, s.longitude, s.height), dtype=np.float64
        )
        self.v_G = np.array(s.v_G, dtype=np.float64)
        psi = 0.5 * math.pi - s.grid_heading
        self.C_b_G = np.ascontiguousarray(
            attitude.matrix_from_euler(psi, s.pitch, s.roll), dtype=np.float64
        )
        self.b_gyro_b = np.zeros(3)
        self.b_accel_b = np.zeros(3)
        self.dvl_scale_m = np.zeros(3)
        self.dvl_markov_m = np.zeros(3)
        self.usbl_bias_a = np.zeros(3)
        sigma = np.concatenate(
            [
                [s.sigma_tilt, s.sigma_tilt, s.sigma_heading],
                np.full(3, s.sigma_velocity),
                np.zeros(3),
                np.full(3, p.gyro_bias_sigma),
                np.full(3, p.accel_bias_sigma),
                np.full(3, p.dvl_scale_sigma),
                np.full(3, p.dvl_markov_sigma),
                np.full(3, p.usbl_bias_sigma),
            ]
        )
        self.P = np.diag(sigma**2)
        C_e_G = grid.ecef_to_grid(self.r_e)
        position_G = np.diag([s.sigma_position_horizontal**2] * 2 + [s.sigma_position_vertical**2])
        self.P[6:9, 6:9] = C_e_G.T @ position_G @ C_e_G

    def _allocate(self) -> None:
        self.scratch = kf.scratch()
        self.C_e_G = np.zeros((3, 3))
        self.omega_ie_G = np.zeros(3)
        self.omega_eG_G = np.zeros(3)
        self.lever_G = np.zeros(3)
        self.point_e = np.zeros(3)
        self.velocity_e = np.zeros(3)
        self.height = 0.0
        self._lever_point_b = np.array(self._p.transponder_lever_b)
        self._lever_dvl_b = np.array(self._p.dvl_lever_b)
        self._lever_depth_b = np.array(self._p.depth_lever_b)
        roll, pitch, yaw = (math.radians(a) for a in self._p.dvl_rpy_deg)
        self._C_m_b = np.ascontiguousarray(
            attitude.matrix_from_euler(yaw, pitch, roll), dtype=np.float64
        )
        self._C_m_G = np.zeros((3, 3))
        self._C_mean = np.zeros((3, 3))
        self._f_mean = np.zeros(3)
        self._omega_mean = np.zeros(3)
        self.H = np.zeros((3, kf.N))
        self.R = np.zeros((3, 3))
        self.z = np.zeros(3)
        self.x = np.zeros(kf.N)
        self.estimates_usbl_bias = self._p.usbl_bias_sigma > 0.0
        self._active = kf.N if self.estimates_usbl_bias else 21

    # -- time -------------------------------------------------------------------------------------

    def imu(self, sample: ImuSample) -> None:
        """Advance to the end of the sample's interval.

        Raises
        ------
        FilterDivergence
            When the covariance is not positive definite or the state not finite at the end of a
            covariance step.
        """
        dt = (sample.stamp_ns - self.stamp_ns) * 1e-9
        omega_b, f_b = sample.omega_ib_b, sample.f_b
        if self._p.imu_sample == 'instant' and self._previous_sample is not None:
            omega_b = 0.5 * (omega_b + self._previous_sample.omega_ib_b)
            f_b = 0.5 * (f_b + self._previous_sample.f_b)
        self._previous_sample = sample
        filter_imu.imu_step(
            self.C_b_G,
            self.v_G,
            self.r_e,
            self.b_gyro_b,
            self.b_accel_b,
            omega_b,
            f_b,
            self._increments,
            dt,
            self._previous_dt,
            self._sums,
        )
        self._previous_dt = dt
        self.omega_ib_b[:] = omega_b
        self.stamp_ns = sample.stamp_ns
        if sample.stamp_ns // self._step_ns != self._boundary_ns // self._step_ns:
            self._predict((sample.stamp_ns - self._boundary_ns) * 1e-9)
            self._boundary_ns = sample.stamp_ns
        self._locate()
        self.history.add_epoch(sample.stamp_ns, self.point_e, self.velocity_e, self.lever_G)

    def _predict(self, dt: float) -> None:
        w = self.scratch
        filter_imu.take_means(self._sums, self._C_mean, self._f_mean, self._omega_mean)
        Phi = self.history.next_transition()
        tau_usbl = self._p.usbl_bias_tau if self._p.usbl_bias_sigma > 0.0 else 0.0
        kf.fill_transition(
            Phi,
            w['F15'],
            self.r_e,
            self.v_G,
            self._C_mean,
            self._omega_mean,
            self._f_mean,
            dt,
            self._p.dvl_markov_tau,
            tau_usbl,
        )
        self.last_q = self._process_noise(dt)
        kf.predict(self.P, Phi, self.last_q, w['M'])
        # The mean of a Markov error decays as its transition says.
        decay = math.exp(-dt / self._p.dvl_markov_tau)
        self.dvl_markov_m *= decay
        if tau_usbl:
            self.usbl_bias_a *= math.exp(-dt / tau_usbl)
        if not kf.cholesky(w['LP'], self.P, self._active) or not math.isfinite(
            float(np.sum(self.r_e + self.v_G))
        ):
            raise FilterDivergence('the covariance of the filter is no longer positive definite')

    def _process_noise(self, dt: float) -> Array:
        """Variances added in a step of dt, shape (24,)."""
        cached = self._process_noise_of.get(dt)
        if cached is not None:
            return cached
        p = self._p
        q = np.zeros(kf.N)
        q[0:3] = p.gyro_noise_density**2 * dt
        q[3:6] = p.accel_noise_density**2 * dt
        q[9:12] = p.gyro_bias_walk**2 * dt
        q[12:15] = p.accel_bias_walk**2 * dt
        q[_MARKOV] = p.dvl_markov_sigma**2 * -math.expm1(-2.0 * dt / p.dvl_markov_tau)
        q[_USBL] = p.usbl_bias_sigma**2 * -math.expm1(-2.0 * dt / p.usbl_bias_tau)
        if len(self._process_noise_of) < 64:  # a jittering IMU clock must not fill the memory
            self._process_noise_of[dt] = q
        return q

    def _locate(self) -> None:
        self.height = filter_imu.place(
            self.r_e,
            self.v_G,
            self.C_b_G,
            self._lever_point_b,
            self.C_e_G,
            self.omega_ie_G,
            self.omega_eG_G,
            self.lever_G,
            self.point_e,
            self.velocity_e,
        )

    # -- measurements -----------------------------------------------------------------------------

    def dvl(self, ping: DvlPing, noise: StatedNoise) -> Outcome:
        """Fuse one valid DVL ping."""
        filter_rows.dvl_rows(
            self.H,
            self.R,
            self.z,
            self._C_m_G,
            self.C_b_G,
            self.v_G,
            self.omega_ib_b,
            self.omega_ie_G,
            self.b_gyro_b,
            self.dvl_scale_m,
            self.dvl_markov_m,
            ping.v_m,
            ping.covariance_m,
            self._C_m_b,
            self._lever_dvl_b,
        )
        return self.fuse(3, noise)

    def depth(self, sample: DepthSample) -> Outcome:
        """Fuse one depth."""
        filter_rows.depth_rows(
            self.H,
            self.R,
            self.z,
            self.C_e_G,
            self.C_b_G,
            self.height,
            self._p.sea_surface_height - sample.depth,
            sample.variance,
            self._lever_depth_b,
        )
        return self.fuse(1, None)

    def fuse(self, m: int, noise: StatedNoise | None) -> Outcome:
        """Gate, update and feed back what stands in ``H``, ``R``, ``z`` (first m rows).

        Raises
        ------
        FilterDivergence
            When the innovation covariance is not positive definite.
        """
        stated = self.R.copy()
        if noise is not None:
            noise.apply(self.R)
        outcome = self._judge(self.P, self.H, self.R, self.z, m)
        if not outcome.fused:
            return outcome
        if noise is not None:
            noise.learn(self.z, stated)
        w = self.scratch
        kf.update(
            self.P,
            self.x,
            self.H,
            self.R,
            self.z,
            m,
            w['K'],
            w['PHt'],
            w['L'],
            w['M'],
        )
        self._feed_back(self.x)
        return outcome

    def _judge(self, P: Array, H: Array, R: Array, z: Array, m: int) -> Outcome:
        """Innovation covariance, NIS and gate; leaves PHt, S and L in the scratch."""
        w = self.scratch
        kf.innovation_covariance(w['S'], w['PHt'], P, H, R, m)
        return self._gate(z, m)

    def _gate(self, z: Array, m: int) -> Outcome:
        """Outcome by the innovation covariance in the scratch."""
        w = self.scratch
        if not kf.cholesky(w['L'], w['S'], m):
            raise FilterDivergence('an innovation covariance is not positive definite')
        nis = float(kf.nis_of(w['L'], z, w['w'], m))
        gate = chi2_gate(self._gate_probability, m)
        variance = np.full(3, np.nan)
        variance[:m] = np.diagonal(w['S'])[:m]
        innovation = np.full(3, np.nan)
        innovation[:m] = z[:m]
        return Outcome(nis <= gate, innovation, variance, nis, m, gate)

    def _feed_back(self, x: Array) -> None:
        """Take an estimated error out of the state, and remember it."""
        kf.feed_back(
            x,
            self.C_b_G,
            self.v_G,
            self.r_e,
            self.b_gyro_b,
            self.b_accel_b,
            self.dvl_scale_m,
            self.dvl_markov_m,
            self.usbl_bias_a,
        )
        self.history.add_correction(x)
        self._locate()

    def fuse_clone(
        self, C: Array, P_cc: Array, stated: Array, z: Array, noise: StatedNoise
    ) -> tuple[Outcome, Used]:
        """Fuse a measurement of a past position that is correlated with the present by ``C``.

        Raises
        ------
        FilterDivergence
            When the innovation covariance is not positive definite.
        """
        w = self.scratch
        R = stated.copy()
        noise.apply(R)
        w['S'][:] = P_cc + R
        outcome = self._gate(z, 3)
        K, S, L = np.zeros((3, kf.N)), w['S'].copy(), w['L'].copy()
        if outcome.fused:
            noise.learn(z, stated)
            kc.clone_fuse(self.P, self.x, C, P_cc, R, L, z, K, w['M'])
            self._feed_back(self.x)
        return outcome, (self.x.copy(), K, S, L, R)

    def fuse_into(
        self,
        P: Array,
        H: Array,
        stated: Array,
        z: Array,
        noise: StatedNoise | None,
        *,
        gated: bool,
        m: int = 3,
    ) -> tuple[Outcome, Used]:
        """Update another covariance than the present one; nothing is fed back.

        Raises
        ------
        FilterDivergence
            When the innovation covariance is not positive definite.
        """
        w = self.scratch
        R = stated.copy()
        if noise is not None:
            noise.apply(R)
        outcome = self._judge(P, H, R, z, m)
        if not gated:
            outcome = replace(outcome, fused=True)
        S, L, x = w['S'].copy(), w['L'].copy(), np.zeros(kf.N)
        if outcome.fused:
            if noise is not None:
                noise.learn(z, stated)
            kf.update(P, x, H, R, z, m, w['K'], w['PHt'], L, w['M'])
        return outcome, (x, w['K'].copy(), S, L, R)

    def replace_estimate(self, P: Array, change: Array) -> None:
        """Take another covariance, and an estimate that differs by ``change`` (as an error)."""
        self.P[:] = P
        self._feed_back(-change)

    def refer_to_now(self, first_correction: int) -> None:
        """Take what was fed back since out of ``z``, as if the rows had stayed the same."""
        h = self.history
        for i in range(first_correction, h.correction):
            correction = h.corrections[i % len(h.corrections)]
            for a in range(3):
                self.z[a] -= float(np.sum(self.H[a] * correction))

    def snapshot(self) -> dict[str, Any]:
        """Copy of everything that changes with time, the stored past's counters included."""
        state = {name: getattr(self, name).copy() for name in _ARRAYS}
        state |= {name: getattr(self, name) for name in _VALUES}
        state['history'] = (self.history.count, self.history.step, self.history.correction)
        return state

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a snapshot."""
        for name in _ARRAYS:
            getattr(self, name)[...] = state[name]
        for name in _VALUES:
            setattr(self, name, state[name])
        self.history.count, self.history.step, self.history.correction = state['history']
        self._locate()

    def walk_to_now(self, first_step: int, first_correction: int) -> int:
        """Bring the rows in ``H`` and ``z`` from a stored step to now; the number of steps."""
        h, w = self.history, self.scratch
        filter_walk.walk_forward(
            self.H,
            self.z,
            3,
            h.transitions,
            first_step,
            h.step,
            h.corrections,
            h.correction_steps,
            first_correction,
            h.correction,
            w['LU'],
            w['pivot'],
        )
        return h.step - first_step


_GATES: dict[tuple[float, int], float] = {}


def chi2_gate(probability: float, dof: int) -> float:
    """Threshold that a good NIS stays below with the given probability; infinite for 1."""
    key = (probability, dof)
    if key not in _GATES:
        # The chi-square quantile; scipy.stats would cost every start of a node half a second.
        quantile = (
            math.inf if probability >= 1.0 else 2.0 * float(gammaincinv(dof / 2, probability))
        )
        _GATES[key] = quantile
    return _GATES[key]
