"""A simulated run offline, as arrays: truth, readings of the follower's sensors, late fixes.

Truth and sensor models are those of polar_nav_sim; nothing here needs ROS. Truth and every noise
stream depend on the seed and on the sensors only, never on a filter: configurations that are
compared at one seed see the same numbers.

::

    world = make_world(WorldSpec(duration_s=600.0, imu='paper_6_2'), FixSpec(delay_s=5.0), seed=1)
    params = world.params(delay_handling='rewind', configuration='custom')
    result = engine.run.run(params, world.inputs)
    errors = track_errors(world, result.track)          # experiments/errors.py
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.inputs import Inputs, Stamps
from polar_nav_core.engine.params import NO_COMMON_ERRORS, NO_RESERVE, EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_sim.initial_state import InitialSigma, initial_parameters
from polar_nav_sim.mission import Mission
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.imu import DPH, G0, ImuErrors, ImuSensor
from polar_nav_sim.sensors.instruments import IMU
from polar_nav_sim.sensors.noise import GaussMarkov
from polar_nav_sim.trajectory import Truth, TruthState

from . import schedule
from .recorded import RecordedImu
from .schedule import FixSpec
from .world_spec import VEHICLE, WorldSpec

_BLOCK = 50_000
"""IMU samples of truth made at a time: bounds memory, a run of 12 h has two million."""


@dataclass(frozen=True)
class Constants:
    """True constant errors of one run, which the filter estimates.

    Attributes
    ----------
    gyro_bias_b, accel_bias_b, dvl_scale_m : (3,) arrays
        [rad/s], [m/s^2], [-].
    """

    gyro_bias_b: Array
    accel_bias_b: Array
    dvl_scale_m: Array


@dataclass(frozen=True)
class World:
    """One simulated run.

    Attributes
    ----------
    inputs : Inputs
        For ``polar_nav_core.engine.run.run``; fixes as scheduled.
    truth : Truth
        State at any time.
    constants : Constants
        True constant sensor errors.
    dvl_markov_m : (d, 3) array
        True slowly varying velocity error at the pings [m/s].
    initial : dict
        Parameters ``initial_*`` of the engine.
    recorded : RecordedImu or None
        Errors of a real IMU that were added.
    under_way : tuple of Fix
        Valid within the run, received after its end.
    """

    spec: WorldSpec
    fix_spec: FixSpec
    seed: int
    inputs: Inputs
    truth: Truth
    constants: Constants
    dvl_markov_m: Array
    initial: dict[str, Any] = field(repr=False)
    recorded: RecordedImu | None = None
    under_way: tuple[Fix, ...] = ()

    def params(self, **changes: Any) -> EngineParams:  # noqa: ANN401 - of EngineParams
        """Engine parameters with this world's statistics, and ``changes``.

        White noise of the IMU is isotropic in the engine: per triad the root mean square over the
        axes. For a recorded IMU it is measured in the recording, and the prior of the constants
        covers the mean of the recording.
        """
        s = self.spec
        imu = IMU[s.imu].errors if s.imu in IMU else ImuErrors()
        gyro, accel = _rms(imu.gyro_noise_density), _rms(imu.accel_noise_density)
        gyro_bias, accel_bias = s.gyro_bias_dph * DPH, s.accel_bias_g * G0
        if self.recorded is not None:
            gyro, accel = self.recorded.noise_density()
            mean = self.recorded.largest_mean()
            gyro_bias, accel_bias = math.hypot(gyro_bias, mean[0]), math.hypot(accel_bias, mean[1])
        values: dict[str, Any] = {
            **NO_COMMON_ERRORS,
            **NO_RESERVE,
            **self.initial,
            'gyro_bias_sigma': gyro_bias,
            'accel_bias_sigma': accel_bias,
            'gyro_noise_density': gyro,
            'accel_noise_density': accel,
            'dvl_scale_sigma': s.dvl_scale,
            'dvl_markov_sigma': s.dvl_markov_sigma,
            'dvl_markov_tau': s.dvl_markov_tau_s,
            'dvl_sigma': s.dvl_sigma,
            'depth_sigma': s.depth_sigma,
            **changes,
        }
        return EngineParams(**values)

    def clairvoyant(self) -> World:
        """The same world with every fix that is not lost received when valid."""
        return self.with_fixes(schedule.clairvoyant(self.inputs.fixes + self.under_way))

    def with_fixes(self, fixes: tuple[Fix, ...]) -> World:
        """The same world with other fixes."""
        return replace(self, inputs=replace(self.inputs, fixes=fixes))


def make_world(
    spec: WorldSpec, fixes: FixSpec, seed: int, recorded: RecordedImu | None = None
) -> World:
    """World of a simulated run.

    Parameters
    ----------
    spec, fixes : WorldSpec, FixSpec
        Run, sensors and fixes to simulate.
    seed : int
        Seed of all random streams; the truth does not depend on it.
    recorded : RecordedImu, optional
        For ``spec.imu == 'recorded'``.

    Raises
    ------
    ConfigError
        When the mission cannot be sailed, or the recording does not fit.
    """
    mission, truth, delta_theta_b, delta_v_b = _ideal(_truth_key(spec))
    n = len(delta_theta_b)
    stamps = mission.start_ns + mission.imu_period_ns * np.arange(1, n + 1, dtype=np.int64)
    constants = _constants(spec, seed)
    end_ns = int(stamps[-1])
    found = _fixes(spec, fixes, seed, truth, int(stamps[0]), end_ns)
    sensor = ImuSensor(spec.imu_errors(), mission.imu_period_ns * 1e-9, _stream(seed, 'imu'))
    omega_b, f_b = sensor.measure(0, delta_theta_b, delta_v_b)
    omega_b += constants.gyro_bias_b
    f_b += constants.accel_bias_b
    if spec.imu == 'recorded':
        _add_recorded(spec, recorded, omega_b, f_b)
    dvl_stamps = _every(stamps, spec.imu_rate_hz, spec.dvl_rate_hz, 'dvl_rate_hz')
    depth_stamps = _every(stamps, spec.imu_rate_hz, spec.depth_rate_hz, 'depth_rate_hz')
    dvl_v_m, markov_m = _dvl(spec, seed, truth, dvl_stamps, constants)
    inputs = Inputs(
        imu_stamps_ns=stamps,
        omega_ib_b=omega_b,
        f_b=f_b,
        dvl_stamps_ns=dvl_stamps,
        dvl_v_m=dvl_v_m,
        dvl_covariance_m=np.broadcast_to(
            spec.dvl_sigma**2 * np.eye(3), (len(dvl_stamps), 3, 3)
        ).copy(),
        dvl_valid=np.ones(len(dvl_stamps), dtype=bool),
        depth_stamps_ns=depth_stamps,
        depth=_depth(spec, seed, truth, depth_stamps),
        depth_variance=np.full(len(depth_stamps), spec.depth_sigma**2),
        fixes=tuple(fix for fix in found if fix.receive_ns <= end_ns),
    )
    return World(
        spec,
        fixes,
        seed,
        inputs,
        truth,
        constants,
        markov_m,
        _initial(spec, seed, truth.state(int(stamps[0]))),
        recorded if spec.imu == 'recorded' else None,
        tuple(fix for fix in found if fix.receive_ns > end_ns),
    )


def _truth_key(spec: WorldSpec) -> WorldSpec:
    """Fields that the truth depends on, so that runs with equal truth share it."""
    names = (
        'duration_s', 'mission', 'latitude_deg', 'longitude_deg', 'course_deg', 'course_north',
        'speed_mps', 'depth_m', 'oscillating', 'imu_rate_hz',
    )  # fmt: skip
    return WorldSpec(**{name: getattr(spec, name) for name in names})


@lru_cache(maxsize=2)
def _ideal(spec: WorldSpec) -> tuple[Mission, Truth, Array, Array]:
    """Truth and the ideal increments of every IMU interval; read-only, as they are shared."""
    mission = spec.plan()
    truth = mission.truth(mission.followers[0])
    n = mission.sample_count - 1
    delta_theta_b, delta_v_b = np.empty((n, 3)), np.empty((n, 3))
    for k0 in range(1, n + 1, _BLOCK):
        k1 = min(k0 + _BLOCK, n + 1)
        block = truth.samples(k0, k1)
        delta_theta_b[k0 - 1 : k1 - 1] = block.delta_theta_b
        delta_v_b[k0 - 1 : k1 - 1] = block.delta_v_b
    delta_theta_b.flags.writeable = delta_v_b.flags.writeable = False
    return mission, truth, delta_theta_b, delta_v_b


def _stream(seed: int, name: str) -> np.random.Generator:
    return stream(seed, f'{VEHICLE}/{name}')


def _rms(values: tuple[float, ...]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _constants(spec: WorldSpec, seed: int) -> Constants:
    drawn = _stream(seed, 'constants').standard_normal((3, 3))
    factor = {'paper': np.ones((3, 3)), 'prior': drawn, 'none': np.zeros((3, 3))}[spec.constants]
    return Constants(
        spec.gyro_bias_dph * DPH * factor[0],
        spec.accel_bias_g * G0 * factor[1],
        spec.dvl_scale * factor[2],
    )


def _add_recorded(
    spec: WorldSpec, recorded: RecordedImu | None, omega_b: Array, f_b: Array
) -> None:
    if recorded is None:
        raise ConfigError('imu recorded: there is no recording')
    if abs(recorded.rate_hz - spec.imu_rate_hz) > 1e-3 * spec.imu_rate_hz:
        raise ConfigError(
            f'parameter imu_rate_hz: {spec.imu_rate_hz} Hz, the recording has {recorded.rate_hz}'
        )
    rows = np.arange(len(omega_b)) % len(recorded.omega_b)
    omega_b += recorded.omega_b[rows]
    f_b += recorded.f_b[rows]


def _every(stamps: Stamps, imu_rate_hz: float, rate_hz: float, name: str) -> Stamps:
    """Stamps of a slower sensor, each at an IMU stamp."""
    if rate_hz == 0.0:
        return stamps[:0]
    stride = round(imu_rate_hz / rate_hz)
    if stride < 1 or abs(stride * rate_hz - imu_rate_hz) > 1e-9 * imu_rate_hz:
        raise ConfigError(f'parameter {name}: {rate_hz} Hz does not divide {imu_rate_hz} Hz')
    return stamps[stride - 1 :: stride]


def _blocks(truth: Truth, stamps: Stamps) -> list[tuple[slice, TruthState]]:
    starts = range(0, len(stamps), _BLOCK)
    return [(slice(i, i + _BLOCK), truth.state(stamps[i : i + _BLOCK])) for i in starts]


def _dvl(
    spec: WorldSpec, seed: int, truth: Truth, stamps: Stamps, constants: Constants
) -> tuple[Array, Array]:
    """Pings and their true slowly varying part; the DVL's axes are the body's."""
    rng = _stream(seed, 'dvl')
    n = len(stamps)
    if n == 0:
        return np.empty((0, 3)), np.empty((0, 3))
    sigma = np.full(3, spec.dvl_markov_sigma if spec.noisy else 0.0)
    slow = GaussMarkov(sigma, spec.dvl_markov_tau_s, 1.0 / spec.dvl_rate_hz, rng.normal(size=3))
    markov_m = slow.advance(rng.standard_normal((n, 3)))
    white = (spec.dvl_sigma if spec.noisy else 0.0) * rng.standard_normal((n, 3))
    v_m = np.empty((n, 3))
    for rows, state in _blocks(truth, stamps):
        v_m[rows] = np.einsum('nji,nj->ni', state.C_b_G, state.v_G)
    return (1.0 + constants.dvl_scale_m) * v_m + markov_m + white, markov_m


def _depth(spec: WorldSpec, seed: int, truth: Truth, stamps: Stamps) -> Array:
    noise = _stream(seed, 'depth').standard_normal(len(stamps))
    out = (spec.depth_sigma if spec.noisy else 0.0) * noise
    for rows, state in _blocks(truth, stamps):
        # The engine counts depth from the ellipsoid by default.
        out[rows] -= state.h
    return np.asarray(out)


def _fixes(
    spec: WorldSpec, fixes: FixSpec, seed: int, truth: Truth, start_ns: int, end_ns: int
) -> tuple[Fix, ...]:
    validity = schedule.validity_times(fixes, truth.start_ns, end_ns)
    n = len(validity)
    delay = schedule.delays_ns(fixes, n, _stream(seed, 'delay'))
    rng = _stream(seed, 'fix')
    sigma_G = np.array([fixes.sigma, fixes.sigma, fixes.sigma_vertical])
    leader_G = fixes.leader_sigma * np.append(rng.standard_normal(2), 0.0)
    noise_G = leader_G + sigma_G * rng.standard_normal((n, 3))
    if not spec.noisy:
        noise_G[:] = 0.0
    keep = (delay >= 0) & (validity >= start_ns)
    validity, delay, noise_G = validity[keep], delay[keep], noise_G[keep]
    variance_G = sigma_G**2 + np.array([1.0, 1.0, 0.0]) * fixes.leader_sigma**2
    # A fix without noise still has to state one.
    variance_G = np.maximum(variance_G, 1e-12)
    r_e, covariance_e = np.empty((len(validity), 3)), np.empty((len(validity), 3, 3))
    for rows, state in _blocks(truth, validity):
        C_e_G = state.C_e_G
        r_e[rows] = state.r_e + np.einsum('nji,nj->ni', C_e_G, noise_G[rows])
        covariance_e[rows] = np.einsum('nji,j,njk->nik', C_e_G, variance_G, C_e_G)
    return schedule.fixes_of(validity, validity + delay, r_e, covariance_e)


def _initial(spec: WorldSpec, seed: int, truth: TruthState) -> dict[str, Any]:
    sigma = InitialSigma(
        spec.initial_sigma_position,
        spec.initial_sigma_height,
        spec.initial_sigma_velocity,
        spec.initial_sigma_tilt_deg,
        spec.initial_sigma_heading_deg,
    )
    rng = _stream(seed, 'initial_state')
    drawn = initial_parameters(truth, sigma, rng)
    if spec.initial_errors == 'none':
        zero = InitialSigma(0.0, 0.0, 0.0, 0.0, 0.0)
        exact = initial_parameters(truth, zero, rng)
        stated = {k: v for k, v in drawn.items() if k.startswith('initial_sigma')}
        drawn = {**exact, **stated}
    return {k: tuple(v) if isinstance(v, list) else v for k, v in drawn.items()}
