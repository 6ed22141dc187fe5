"""Strapdown beside python-ins: one IMU record, integrated by all timed programs.

The record is the ideal output of the follower's IMU in the simulator's racetrack mission, at
100 Hz with oscillating attitude, so that each end position can be compared with the truth too.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from polar_nav_core import earth, grid
from polar_nav_core.arrays import Array
from polar_nav_core.errors import PolarNavError
from polar_nav_core.kernels.frames import blocks
from polar_nav_core.kernels.frames import strapdown as steps
from polar_nav_core.kernels.sins import imu as filter_imu
from polar_nav_sim.mission import load_mission

from . import compiled, twin
from .rounds import Entry

if TYPE_CHECKING:
    import pandas as pd
    from pyins.strapdown import Integrator

MISSION, VEHICLE = 'racetrack', 'follower'
BLOCK = 10
SAMPLES, MOST_SAMPLES = 60_000, 360_000
COMPARED_SAMPLES = 60_000
"""The bounds of agreement are for up to ten minutes: a free vertical channel is unstable."""
_CHUNK = 20_000

TWIN_SAMPLES = 1000
CALLED_SAMPLES = 20_000
PEER_CALLED_SAMPLES = 100

OWN_BOUND_M = 1e-3
"""Core and NumPy twin against the truth, all three axes."""
PEER_HORIZONTAL_BOUND_M = 5e-3
PEER_VERTICAL_BOUND_M = 0.1
"""Core against python-ins after ten minutes, free vertical channel included."""

_FRD = np.diag([1.0, -1.0, -1.0])
"""Body axes of python-ins are forward, right, down."""

State = tuple[Array, Array, Array]


class Disagreement(PolarNavError):
    """Programs that should do the same work have different results."""


@dataclass(frozen=True)
class Record:
    """IMU increments and the truth.

    Attributes
    ----------
    C_b_G, v_G, r_e : ndarray
        State at row 0.
    dtheta_b, dvel_b : ndarray, shape (n + 1, 3)
        Row k is of the interval that ends at k dt [rad], [m/s]; row 0, of no interval, is zero.
    dt : float
        [s]
    truth_r_e : ndarray, shape (n + 1, 3)
        True positions [m].
    """

    C_b_G: Array
    v_G: Array
    r_e: Array
    dtheta_b: Array
    dvel_b: Array
    dt: float
    truth_r_e: Array

    @property
    def samples(self) -> int:
        """Number of intervals."""
        return len(self.dtheta_b) - 1

    def first(self, n: int) -> Record:
        """Record of the first n intervals."""
        rows = slice(0, n + 1)
        return Record(
            self.C_b_G, self.v_G, self.r_e, self.dtheta_b[rows], self.dvel_b[rows], self.dt,
            self.truth_r_e[rows],
        )  # fmt: skip

    def start(self) -> State:
        """Copies of the state at row 0."""
        return self.C_b_G.copy(), self.v_G.copy(), self.r_e.copy()


def record(samples: int) -> Record:
    """IMU record of the first samples of the mission.

    Raises
    ------
    ValueError
        For less than 1 or more than MOST_SAMPLES.
    """
    if not 1 <= samples <= MOST_SAMPLES:
        raise ValueError(f'samples must be 1 to {MOST_SAMPLES}, not {samples}')
    mission = load_mission(MISSION)
    needed_s = (samples + 1) * mission.imu_period_ns * 1e-9
    truth = mission.with_duration(max(needed_s, mission.duration_s)).truth(VEHICLE)
    end = samples + 1
    chunks = [truth.samples(k, min(k + _CHUNK, end)) for k in range(0, end, _CHUNK)]
    start = chunks[0].state
    return Record(
        start.C_b_G[0].copy(), start.v_G[0].copy(), start.r_e[0].copy(),
        np.concatenate([c.delta_theta_b for c in chunks]),
        np.concatenate([c.delta_v_b for c in chunks]),
        truth.period_ns * 1e-9,
        np.concatenate([c.state.r_e for c in chunks]),
    )  # fmt: skip


# -- the core and its twin ------------------------------------------------------------------------


def core_blocks(r: Record) -> State:
    """All samples in one call, navigation rates once per BLOCK samples."""
    C, v, p = r.start()
    blocks.strapdown_blocks(
        C, v, p, r.dtheta_b[1:], r.dvel_b[1:], np.zeros(3), np.zeros(3), r.dt, BLOCK
    )
    return C, v, p


def core_steps(r: Record) -> State:
    """All samples in one call, single steps."""
    C, v, p = r.start()
    steps.strapdown_batch(C, v, p, r.dtheta_b[1:], r.dvel_b[1:], np.zeros(3), np.zeros(3), r.dt)
    return C, v, p


def core_kept(r: Record) -> State:
    """As `core_steps`, with the state after every sample in arrays, as python-ins returns it."""
    C, v, p = r.start()
    n = len(r.dtheta_b)
    kept = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3))
    compiled.strapdown_kept(C, v, p, r.dtheta_b, r.dvel_b, r.dt, *kept)
    return kept[0][-1], kept[1][-1], kept[2][-1]


def core_called(r: Record) -> Callable[[], State]:
    """One call from Python per sample, as the live follower makes it."""
    rates = list(r.dtheta_b[1:] / r.dt)
    forces = list(r.dvel_b[1:] / r.dt)
    zero = np.zeros(3)

    def run() -> State:
        C, v, p = r.start()
        increments, sums, held = np.zeros((4, 3)), np.zeros((6, 3)), np.zeros(8)
        dt_prev = 0.0
        for k, (omega_ib_b, f_b) in enumerate(zip(rates, forces, strict=True)):
            if k % BLOCK == 0:
                filter_imu.hold_surroundings(held, v, p, BLOCK * r.dt)
            filter_imu.imu_step(
                C, v, p, zero, zero, omega_ib_b, f_b, increments, r.dt, dt_prev, sums, held
            )
            dt_prev = r.dt
        return C, v, p

    return run


def numpy_steps(r: Record) -> State:
    """End position of the NumPy twin, ECEF [m]."""
    return twin.strapdown(r.C_b_G, r.v_G, r.r_e, r.dtheta_b[1:], r.dvel_b[1:], r.dt)


# -- python-ins -----------------------------------------------------------------------------------


class PythonIns:
    """The record in the frames and tables of python-ins (module pyins), made before timing.

    Raises
    ------
    PolarNavError
        When python-ins is not installed.
    """

    def __init__(self, r: Record) -> None:
        try:
            import pandas as pd
            from pyins import _numba_integrate, strapdown, transform, util
        except ImportError as error:
            raise PolarNavError(
                f'{error.name} is not installed: the benchmarks need all of requirements.lock'
            ) from error
        self._strapdown, self._kernel = strapdown, _numba_integrate
        lat, lon, height = (float(x) for x in earth.geodetic_from_ecef(r.r_e))
        C_e_n = transform.mat_en_from_ll(np.degrees(lat), np.degrees(lon)).T
        C_G_n = C_e_n @ np.asarray(grid.ecef_to_grid(r.r_e)).T
        rph = transform.mat_to_rph(C_G_n @ r.C_b_G @ _FRD)
        start = [np.degrees(lat), np.degrees(lon), height, *(C_G_n @ r.v_G), *rph]
        self._pva = pd.Series(start, index=util.TRAJECTORY_COLS)
        self._imu = pd.DataFrame(
            np.hstack([r.dtheta_b @ _FRD, r.dvel_b @ _FRD]),
            index=np.arange(r.samples + 1) * r.dt,
            columns=util.GYRO_COLS + util.ACCEL_COLS,
        )
        increments = self._increments()
        self._rows = [increments.iloc[k : k + 1] for k in range(min(r.samples, 1000))]
        self._dt = np.asarray(increments.dt)
        self._theta = np.ascontiguousarray(increments[['theta_x', 'theta_y', 'theta_z']])
        self._dv = np.ascontiguousarray(increments[['dv_x', 'dv_y', 'dv_z']])
        integrator = self._integrator()
        n = r.samples + 1
        self._states = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3, 3))
        first = integrator.lla, integrator.velocity_n, integrator.mat_nb
        for mine, its in zip(self._states, first, strict=True):
            mine[0] = its[0]

    def _increments(self) -> pd.DataFrame:
        return self._strapdown.compute_increments_from_imu(self._imu, 'increment')

    def _integrator(self) -> Integrator:
        with warnings.catch_warnings():
            # It passes `copy` to DataFrame.transpose, which pandas 3 deprecates and ignores.
            warnings.filterwarnings('ignore', 'The copy keyword is deprecated')
            return self._strapdown.Integrator(self._pva)

    def batch(self) -> Array:
        """Coning and sculling, then integration of all samples; end position, ECEF [m]."""
        trajectory = self._integrator().integrate(self._increments())
        return _ecef(trajectory[['lat', 'lon', 'alt']].to_numpy()[-1])

    def kernel(self) -> Array:
        """Its compiled loop alone, on prepared arrays."""
        lla, velocity_n, mat_nb = self._states
        self._kernel.integrate(self._dt, lla, velocity_n, mat_nb, self._theta, self._dv, 0, True)
        return _ecef(lla[-1])

    def called(self, samples: int) -> Array:
        """One call per sample, with prepared increments."""
        integrator = self._integrator()
        for row in self._rows[:samples]:
            integrator.integrate(row)
        return _ecef(integrator.trajectory[['lat', 'lon', 'alt']].to_numpy()[-1])


def _ecef(lla: Array) -> Array:
    """ECEF position [m] of latitude and longitude in degrees and height [m]."""
    return np.asarray(earth.ecef_from_geodetic(np.radians(lla[0]), np.radians(lla[1]), lla[2]))


# -- agreement ------------------------------------------------------------------------------------


def _distance(a: Array, b: Array) -> tuple[float, float]:
    """Horizontal and vertical distance of two positions [m]."""
    up = np.asarray(earth.up(b))
    vertical = float((a - b) @ up)
    return float(np.linalg.norm(a - b - vertical * up)), abs(vertical)


def agreement(r: Record) -> dict[str, float]:
    """Distances of the end positions of all programs, after COMPARED_SAMPLES at most.

    Returns
    -------
    dict
        Distances in metres, by the names of the comparisons.

    Raises
    ------
    Disagreement
        If one is over its bound.
    """
    r = r.first(min(r.samples, COMPARED_SAMPLES))
    peer = PythonIns(r)
    few = r.first(min(r.samples, TWIN_SAMPLES))
    own = {
        'core, blocks, to the truth': (core_blocks(r)[2], r),
        'core, steps, to the truth': (core_steps(r)[2], r),
        'core, called per sample, to the truth': (core_called(r)()[2], r),
        'NumPy twin to the truth': (numpy_steps(few)[2], few),
    }
    found: dict[str, tuple[float, float]] = {}
    for name, (position, its) in own.items():
        found[name] = (float(np.linalg.norm(position - its.truth_r_e[-1])), OWN_BOUND_M)
    core = core_steps(r)
    if not np.array_equal(core_kept(r)[2], core[2]):
        raise Disagreement('core: keeping the states changed the last one')
    called = r.first(min(r.samples, PEER_CALLED_SAMPLES))
    peers = {
        'python-ins': (peer.batch(), core[2]),
        'python-ins, its loop': (peer.kernel(), core[2]),
        'python-ins, called per sample': (peer.called(called.samples), core_steps(called)[2]),
    }
    for name, (position, ours) in peers.items():
        horizontal, vertical = _distance(position, ours)
        found[f'{name}, to the core, horizontal'] = (horizontal, PEER_HORIZONTAL_BOUND_M)
        found[f'{name}, to the core, vertical'] = (vertical, PEER_VERTICAL_BOUND_M)
    for name, (distance, bound) in found.items():
        if not distance <= bound:
            raise Disagreement(
                f'{name}: {distance:.3g} m after {r.samples} samples, over the bound of {bound} m'
            )
    return {name: distance for name, (distance, _) in found.items()}


def entries(r: Record) -> tuple[list[Entry], list[Entry]]:
    """Entries to time: in batches, and with a call per sample."""
    peer = PythonIns(r)
    few = r.first(min(r.samples, TWIN_SAMPLES))
    some = r.first(min(r.samples, CALLED_SAMPLES))
    called = min(r.samples, PEER_CALLED_SAMPLES)
    batch = [
        Entry('blocks', f'core, blocks of {BLOCK} samples', r.samples, partial(core_blocks, r)),
        Entry('steps', 'core, single steps', r.samples, partial(core_steps, r)),
        Entry('kept', 'core, single steps, all states kept', r.samples, partial(core_kept, r)),
        Entry('python_ins', 'python-ins', r.samples, peer.batch),
        Entry('python_ins_loop', 'python-ins, its compiled loop alone', r.samples, peer.kernel),
        Entry('numpy', 'plain NumPy', few.samples, partial(numpy_steps, few)),
    ]
    single = [
        Entry('called', 'core, one call per sample', some.samples, core_called(some)),
        Entry(
            'python_ins_called', 'python-ins, one call per sample', called,
            partial(peer.called, called),
        ),
    ]  # fmt: skip
    return batch, single
