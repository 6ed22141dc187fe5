"""Factor graph of a whole run with GTSAM's CombinedImuFactor, solved at once.

Its navigation frame is the plane that touches the ellipsoid at the start, turning with the Earth:
east, north, up. A node stands at the start and at each depth; between two of them are
all IMU samples, as one factor. GTSAM has no factor for a velocity in body axes, nor for a depth:
those are custom factors, with exact derivatives. GTSAM is no requirement; ``pip install gtsam``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from polar_nav_core import attitude, earth
from polar_nav_core.arrays import Array, Ints
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid

from ..world import World

MISSING = 'GTSAM is not installed (pip install gtsam)'
_ITERATIONS = 20


def gtsam_module() -> Any:  # noqa: ANN401 - gtsam has no types
    """Return GTSAM.

    Raises
    ------
    ConfigError
        When it is not installed.
    """
    try:
        import gtsam
    except ImportError:
        raise ConfigError(MISSING) from None
    return gtsam


@dataclass(frozen=True)
class Solved:
    """Solution at the nodes, in the axes n of a plane.

    Attributes
    ----------
    plane : Plane
    stamps_ns : (k,) array
    C_b_n, v_n, r_n : (k, 3, 3), (k, 3), (k, 3) arrays
    gyro_bias_b, accel_bias_b : (k, 3) arrays
    P_n : (k, 3, 3) array
        Covariance of the position [m^2].
    """

    plane: Plane
    stamps_ns: Ints
    C_b_n: Array
    v_n: Array
    r_n: Array
    gyro_bias_b: Array
    accel_bias_b: Array
    P_n: Array


class Plane:
    """The plane that touches the ellipsoid at a place: axes east, north, up, which stay.

    Parameters
    ----------
    r_e : (3,) array
        Its origin, ECEF [m].
    """

    def __init__(self, r_e: Array) -> None:
        lat, lon, _ = earth.geodetic_from_ecef(r_e)
        self.r_e = r_e
        self.C_e_n = np.asarray(earth.ecef_to_enu(lat, lon))
        self.omega_n = self.C_e_n @ np.array([0.0, 0.0, earth.OMEGA_IE])
        self.gravity = float(earth.gravity(r_e))

    def place(self, r_e: Array) -> Array:
        """Return places [ECEF, m] in this plane's axes [m], of its origin."""
        return (r_e - self.r_e) @ self.C_e_n.T

    def ecef(self, r_n: Array) -> Array:
        """Return places in this plane's axes [m] in ECEF [m]."""
        return self.r_e + r_n @ self.C_e_n

    def samples(self, world: World, at: Solved | None) -> tuple[Array, Array]:
        """Return the IMU's rates and specific forces, as a factor for this plane wants them.

        Those of the world as they are; about a solution *at*, less what such a factor leaves out:
        the Earth's rate, its Coriolis force, gravity where it is another than at the origin, and
        the turn within a sample, which it begins with the attitude of the sample's start.
        """
        inputs = world.inputs
        if at is None:
            return inputs.omega_ib_b, inputs.f_b
        node = np.searchsorted(at.stamps_ns, inputs.imu_stamps_ns).clip(max=len(at.r_n) - 1)
        C_b_n = _turned_back(at, inputs.imu_stamps_ns, inputs.omega_ib_b, node)
        r_e = self.ecef(at.r_n[node])
        g_n = -np.asarray(earth.gravity(r_e))[:, None] * (np.asarray(earth.up(r_e)) @ self.C_e_n.T)
        f_n = g_n - [0.0, 0.0, -self.gravity] - 2.0 * np.cross(self.omega_n, at.v_n[node])
        omega_b = inputs.omega_ib_b - np.einsum('nij,i->nj', C_b_n, self.omega_n)
        f_b = inputs.f_b + np.einsum('nij,ni->nj', C_b_n, f_n)
        return omega_b, f_b + 0.5 / world.spec.imu_rate_hz * np.cross(omega_b, f_b)


def _turned_back(at: Solved, stamps_ns: Ints, omega_b: Array, node: Ints) -> Array:
    """Attitude at each IMU sample: that of the next node, turned back by the rate up to there."""
    back = (at.stamps_ns[node] - stamps_ns) * 1e-9
    return np.asarray(at.C_b_n[node] @ np.asarray(attitude.exp(-omega_b * back[:, None])))


@dataclass(frozen=True)
class Use:
    """One way to use the factor.

    Attributes
    ----------
    coriolis : bool
        Whether the factor is told the Earth's rate (``setOmegaCoriolis``).
    gyro_bias_sigma : float or None
        1-sigma of the gyro's constant [rad/s]; None: that of the engine's parameters.
    about : Solved or None
        A solution about which samples are corrected for what the factor leaves out.
    """

    coriolis: bool = False
    gyro_bias_sigma: float | None = None
    about: Solved | None = None


def solve(world: World, params: EngineParams, use: Use) -> Solved:
    """Solution of a world's whole run.

    Raises
    ------
    ConfigError
        Without GTSAM.
    """
    return _Problem(gtsam_module(), world, params, use).solve()


class _Problem:
    """One run as factors."""

    def __init__(self, gtsam: Any, world: World, params: EngineParams, use: Use) -> None:  # noqa: ANN401
        self._gtsam, self._world, self._params, self._use = gtsam, world, params, use
        start = params.initial_state()
        if start is None:
            raise ConfigError('a factor graph needs a stated start')
        self._start = start
        r_e = np.asarray(earth.ecef_from_geodetic(start.latitude, start.longitude, start.height))
        self._plane = Plane(r_e)
        inputs = world.inputs
        self._nodes = np.concatenate([inputs.imu_stamps_ns[:1], inputs.depth_stamps_ns])
        self._X, self._V, self._B = (partial(gtsam.symbol, letter) for letter in ('x', 'v', 'b'))

    def solve(self) -> Solved:
        """Solution by Levenberg and Marquardt, with the covariance there."""
        g = self._gtsam
        graph, guess = g.NonlinearFactorGraph(), g.Values()
        self._add_start(graph, guess)
        self._add_imu(graph, guess)
        self._add_velocities(graph)
        self._add_depths(graph)
        self._add_fixes(graph)
        options = g.LevenbergMarquardtParams()
        options.setMaxIterations(_ITERATIONS)
        ordering = g.Ordering()
        for k in range(len(self._nodes)):
            for key in (self._X(k), self._V(k), self._B(k)):
                ordering.push_back(key)
        optimizer = g.LevenbergMarquardtOptimizer(graph, guess, ordering, options)
        values = optimizer.optimize()
        return self._read(values, g.Marginals(graph, values))

    def _gaussian(self, covariance: Array) -> Any:  # noqa: ANN401
        return self._gtsam.noiseModel.Gaussian.Covariance(covariance)

    def _add_start(self, graph: Any, guess: Any) -> None:  # noqa: ANN401
        """Add what is known before: place, velocity, attitude and biases."""
        g, s, p = self._gtsam, self._start, self._params
        C_e_n = self._plane.C_e_n
        C_G_n = C_e_n @ np.asarray(ecef_to_grid(self._plane.r_e)).T
        C_b_G = np.asarray(
            attitude.matrix_from_euler(0.5 * np.pi - s.grid_heading, s.pitch, s.roll)
        )
        C_b_n = C_G_n @ C_b_G
        pose = g.Pose3(g.Rot3(C_b_n), np.zeros(3))
        P = np.zeros((6, 6))
        tilt, place = s.sigma_tilt**2, s.sigma_position_horizontal**2
        P[:3, :3] = C_b_n.T @ np.diag([tilt, tilt, s.sigma_heading**2]) @ C_b_n
        P[3:, 3:] = C_b_n.T @ np.diag([place, place, s.sigma_position_vertical**2]) @ C_b_n
        velocity = C_G_n @ np.array(s.v_G)
        gyro = self._use.gyro_bias_sigma or p.gyro_bias_sigma
        sigmas = np.repeat([p.accel_bias_sigma, gyro], 3)
        bias = g.imuBias.ConstantBias()
        graph.add(g.PriorFactorPose3(self._X(0), pose, self._gaussian(P)))
        graph.add(
            g.PriorFactorVector(
                self._V(0), velocity, g.noiseModel.Isotropic.Sigma(3, s.sigma_velocity)
            )
        )
        graph.add(
            g.PriorFactorConstantBias(self._B(0), bias, g.noiseModel.Diagonal.Sigmas(sigmas))
        )
        guess.insert(self._X(0), pose)
        guess.insert(self._V(0), velocity)
        guess.insert(self._B(0), bias)

    def _add_imu(self, graph: Any, guess: Any) -> None:  # noqa: ANN401
        """Add a factor between each two nodes, and guess the nodes by dead reckoning."""
        g, p, one = self._gtsam, self._params, np.eye(3)
        settings = g.PreintegrationCombinedParams.MakeSharedU(self._plane.gravity)
        settings.setGyroscopeCovariance(p.gyro_noise_density**2 * one)
        settings.setAccelerometerCovariance(p.accel_noise_density**2 * one)
        settings.setIntegrationCovariance(1e-10 * one)
        settings.setBiasAccCovariance(p.accel_bias_walk**2 * one)
        settings.setBiasOmegaCovariance(p.gyro_bias_walk**2 * one)
        if self._use.coriolis:
            settings.setOmegaCoriolis(self._plane.omega_n)
        omega_b, f_b = self._plane.samples(self._world, self._use.about)
        stamps = self._world.inputs.imu_stamps_ns
        dt = np.diff(stamps, prepend=stamps[0]) * 1e-9
        last = np.searchsorted(stamps, self._nodes)
        bias = g.imuBias.ConstantBias()
        state = g.NavState(guess.atPose3(self._X(0)), guess.atVector(self._V(0)))
        for k in range(1, len(self._nodes)):
            pim = g.PreintegratedCombinedMeasurements(settings, bias)
            for i in range(last[k - 1] + 1, last[k] + 1):
                pim.integrateMeasurement(f_b[i], omega_b[i], dt[i])
            X, V, B = self._X, self._V, self._B
            graph.add(g.CombinedImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), B(k), pim))
            state = pim.predict(state, bias)
            guess.insert(X(k), state.pose())
            guess.insert(V(k), state.velocity())
            guess.insert(B(k), bias)

    def _add_velocities(self, graph: Any) -> None:  # noqa: ANN401
        """Add the DVL's pings; its axes are the body's."""
        inputs = self._world.inputs
        nodes = np.searchsorted(self._nodes, inputs.dvl_stamps_ns).tolist()
        for k, z, R in zip(nodes, inputs.dvl_v_m, inputs.dvl_covariance_m, strict=True):
            graph.add(self._custom([self._X(k), self._V(k)], R, partial(self._velocity, z)))

    def _add_depths(self, graph: Any) -> None:  # noqa: ANN401
        """Add the depths: below the ellipsoid, which bends away from the plane."""
        inputs = self._world.inputs
        nodes = np.searchsorted(self._nodes, inputs.depth_stamps_ns).tolist()
        for k, z, r in zip(nodes, inputs.depth, inputs.depth_variance, strict=True):
            graph.add(self._custom([self._X(k)], np.array([[r]]), partial(self._depth, z)))

    def _add_fixes(self, graph: Any) -> None:  # noqa: ANN401
        """Add the fixes, each at its time of validity."""
        C_e_n = self._plane.C_e_n
        for fix in self._world.inputs.fixes:
            k = int(np.searchsorted(self._nodes, fix.validity_ns))
            noise = self._gaussian(C_e_n @ fix.covariance_e @ C_e_n.T)
            graph.add(self._gtsam.GPSFactor(self._X(k), self._plane.place(fix.r_e), noise))

    def _custom(self, keys: list[int], R: Array, error: Callable[..., Array]) -> Any:  # noqa: ANN401
        return self._gtsam.CustomFactor(self._gaussian(R), keys, error)

    def _velocity(self, z: Array, factor: Any, values: Any, H: Any) -> Array:  # noqa: ANN401
        keys = factor.keys()
        C_n_b = values.atPose3(keys[0]).rotation().matrix().T
        v_b: Array = C_n_b @ values.atVector(keys[1])
        if H is not None:
            H[0] = np.hstack([_cross(v_b), np.zeros((3, 3))])
            H[1] = C_n_b
        return v_b - z

    def _depth(self, z: float, factor: Any, values: Any, H: Any) -> Array:  # noqa: ANN401
        pose = values.atPose3(factor.keys()[0])
        r_e = self._plane.ecef(pose.translation())
        if H is not None:
            up_n = self._plane.C_e_n @ np.asarray(earth.up(r_e))
            H[0] = np.concatenate([np.zeros(3), -up_n @ pose.rotation().matrix()])[None, :]
        return np.array([-float(earth.geodetic_from_ecef(r_e)[2]) - z])

    def _read(self, values: Any, marginals: Any) -> Solved:  # noqa: ANN401
        keys = range(len(self._nodes))
        poses = [values.atPose3(self._X(k)) for k in keys]
        biases = [values.atConstantBias(self._B(k)) for k in keys]
        C_b_n = np.array([pose.rotation().matrix() for pose in poses])
        P_b = np.array([marginals.marginalCovariance(self._X(k))[3:, 3:] for k in keys])
        return Solved(
            self._plane,
            self._nodes,
            C_b_n,
            np.array([values.atVector(self._V(k)) for k in keys]),
            np.array([pose.translation() for pose in poses]),
            np.array([bias.gyroscope() for bias in biases]),
            np.array([bias.accelerometer() for bias in biases]),
            C_b_n @ P_b @ np.swapaxes(C_b_n, 1, 2),
        )


def _cross(v: Array) -> Array:
    """Return the matrix of the cross product with v."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
