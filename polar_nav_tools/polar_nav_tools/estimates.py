"""Rows of a run to the series that scoring and report take, without a message in between.

The numbers are those of `polar_nav_ros.navigation_outputs` followed by `bags.arrays`, bit for bit
(a test compares); only here they are made for some thousand rows at a time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine import events
from polar_nav_core.engine.batch import Track
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.error_model import X
from polar_nav_msgs.msg import NavState

from .bags.arrays import rotation_from_quaternion
from .series import EstimateSeries, Floats, Receipt

_ROWS = 8192
_CAP = grid.TRUE_HEADING_SIGMA_CAP
_BLOCKS = (X.phi_G, X.dv_G, X.dr_e)
_ERRORS = ('gyro_bias_b', 'accel_bias_b', 'dvl_scale_m', 'dvl_markov_m', 'usbl_bias_a')
_SIGMAS = tuple(f'{name.rpartition("_")[0]}_sigma' for name in _ERRORS)

Columns = dict[str, NDArray[Any]]


class EstimateRows:
    """Takes the rows of a run (`batch.run(sink=...)`) and makes a series of them.

    Of each covariance only the blocks and sigmas stay that are published.

    Parameters
    ----------
    params : EngineParams
        Of the run.
    expected : int
        Number of rows there will be, about: room for so many is set aside.
    """

    def __init__(self, params: EngineParams, expected: int = 0) -> None:
        self._params = params
        self._waiting: list[Columns] = []
        self._rows = 0
        self._room = max(expected, 1)
        self._done: Columns = {}
        self._count = 0

    def take(self, chunk: Track) -> None:
        """Take some rows; they are copied."""
        attitude_G, velocity_G, position_e = (chunk.P[:, b, b].copy() for b in _BLOCKS)
        self._waiting.append(
            {
                'stamp_ns': chunk.stamps_ns.copy(),
                'r_e': chunk.r_e.copy(),
                'v_G': chunk.v_G.copy(),
                'C_b_G': chunk.C_b_G.copy(),
                'P_attitude_G': attitude_G,
                'P_velocity_G': velocity_G,
                'P_position_e': position_e,
                'sigma': np.sqrt(np.diagonal(chunk.P, axis1=1, axis2=2)),
                'errors': chunk.sensor_errors.copy(),
                'local_statistics': chunk.local_statistics.copy(),
                'fixes': chunk.fixes.copy(),
            }
        )
        self._rows += len(chunk.stamps_ns)
        if self._rows >= _ROWS:
            self._convert()

    def series(self, vehicle: str) -> EstimateSeries:
        """Return the whole run."""
        self._convert()
        if not self._done:
            self._put(_columns(_no_rows(), self._params))
        count = self._count
        configuration = self._params.configuration if count else ''
        columns: dict[str, Any] = {name: c[:count] for name, c in self._done.items()}
        return EstimateSeries(
            vehicle=vehicle,
            configuration=configuration,
            configurations=(configuration,) if count else (),
            **columns,
        )

    def _convert(self) -> None:
        if not self._waiting:
            return
        names = list(self._waiting[0])
        rows = {name: np.concatenate([part[name] for part in self._waiting]) for name in names}
        self._waiting, self._rows = [], 0
        self._put(_columns(rows, self._params))

    def _put(self, columns: Columns) -> None:
        """Write rows to their place: arrays that are joined at the end would be there twice."""
        start, stop = self._count, self._count + len(columns['stamp_ns'])
        if not self._done or stop > self._room:
            self._room = max(self._room, stop + stop // 2 if start else stop)
            for name, column in columns.items():
                wider = np.empty((self._room, *column.shape[1:]), dtype=column.dtype)
                if start:
                    wider[:start] = self._done[name][:start]
                self._done[name] = wider
        for name, column in columns.items():
            self._done[name][start:stop] = column
        self._count = stop


def receipts_of(receipts: Iterable[events.Receipt]) -> list[Receipt]:
    """Receipts of a run as scoring takes them: what a FixReceipt says."""
    return [
        Receipt(
            stamp_ns=r.stamp_ns,
            verdict=int(r.verdict),
            verdict_text=r.verdict.name,
            reason=r.reason,
            topic=r.topic,
            source=r.source,
            sequence=r.sequence,
            revision=r.revision,
            validity_ns=r.validity_ns or None,
            transmit_ns=r.transmit_ns or None,
            receive_ns=r.receive_ns or None,
            fused_ns=r.fused_ns or None,
            age_s=(
                (r.receive_ns - r.validity_ns) * 1e-9
                if r.validity_ns and r.receive_ns
                else math.nan
            ),
            delay_handling=r.delay_handling,
            steps_rolled_back=r.steps_rolled_back,
            innovation_G=r.innovation_G,
            innovation_variance_G=r.innovation_variance_G,
            nis=r.nis,
            degrees_of_freedom=r.dof,
            gate=r.gate,
        )
        for r in receipts
    ]


def _no_rows() -> Columns:
    return {
        'stamp_ns': np.zeros(0, dtype=np.int64),
        **{name: np.zeros((0, 3)) for name in ('r_e', 'v_G')},
        **{
            name: np.zeros((0, 3, 3))
            for name in ('C_b_G', 'P_attitude_G', 'P_velocity_G', 'P_position_e')
        },
        'sigma': np.zeros((0, X.size)),
        'errors': np.zeros((0, 15)),
        'local_statistics': np.zeros((0, 2, 3)),
        'fixes': np.zeros((0, 3), dtype=np.int64),
    }


def _columns(rows: Columns, params: EngineParams) -> Columns:
    """Columns of an EstimateSeries; see `navigation_outputs.nav_to_msg` for each."""
    r_e, C_b_G, sigma, stamp_ns = (rows[n] for n in ('r_e', 'C_b_G', 'sigma', 'stamp_ns'))
    count = len(stamp_ns)
    lat, lon, height = (np.atleast_1d(v) for v in earth.geodetic_from_ecef(r_e))
    x, y = r_e[:, 0], r_e[:, 1]
    # math.hypot, as there: NumPy's differs in the last bit.
    distance = np.fromiter(map(math.hypot, x.tolist(), y.tolist()), np.float64, count)
    C_e_G = grid.ecef_to_grid(r_e)
    psi, pitch, roll = attitude.euler_from_matrix(C_b_G)
    grid_heading = np.mod(0.5 * np.pi - psi, 2.0 * np.pi)
    sigma_east = np.sqrt(_variance_true_east(r_e, distance, rows['P_position_e']))
    heading, heading_sigma, convergence = _true_heading(r_e, grid_heading, sigma[:, 2], sigma_east)
    fixes = rows['fixes']
    age = np.where(fixes[:, 1] > 0, (stamp_ns - fixes[:, 2]) * 1e-9, np.nan)
    return {
        'stamp_ns': stamp_ns,
        'status': np.full(count, NavState.STATUS_NAVIGATING, dtype=np.uint8),
        'r_e': r_e,
        'latitude': lat,
        'longitude': np.where(distance > 0.0, lon, np.nan),
        'height': height,
        'depth': params.sea_surface_height - height,
        'v_G': rows['v_G'],
        'C_b_G': rotation_from_quaternion(attitude.quaternion_from_matrix(C_b_G)),
        'roll': roll,
        'pitch': pitch,
        'grid_heading': grid_heading,
        'true_heading': heading,
        'true_heading_sigma': heading_sigma,
        'convergence': convergence,
        'P_position_G': np.einsum('nik,nkl,njl->nij', C_e_G, rows['P_position_e'], C_e_G),
        'P_velocity_G': rows['P_velocity_G'],
        'P_attitude_G': rows['P_attitude_G'],
        **{name: rows['errors'][:, 3 * i : 3 * i + 3] for i, name in enumerate(_ERRORS)},
        **{name: sigma[:, 9 + 3 * i : 12 + 3 * i] for i, name in enumerate(_SIGMAS)},
        'fixes_received': fixes[:, 0],
        'fixes_fused': fixes[:, 1],
        'age_of_last_fix': age,
        'local_statistics': rows['local_statistics'],
    }


def _variance_true_east(r_e: Floats, distance: Floats, P_e: Floats) -> Floats:
    """Variance of position along true east [m^2]; at a pole, along the y axis of ECEF."""
    away = distance > 0.0
    p = np.where(away, distance, 1.0)
    east = np.zeros_like(r_e)
    east[:, 0] = np.where(away, -r_e[:, 1] / p, 0.0)
    east[:, 1] = np.where(away, r_e[:, 0] / p, 1.0)
    total = np.zeros(len(r_e))
    for i in range(3):  # in the order of the sum there
        inner = np.zeros(len(r_e))
        for j in range(3):
            inner = inner + (east[:, i] * P_e[:, i, j]) * east[:, j]
        total = total + inner
    return np.where(total < 0.0, 0.0, total)


def _true_heading(
    r_e: Floats, grid_heading: Floats, sigma_grid: Floats, sigma_east: Floats
) -> tuple[Floats, Floats, Floats]:
    """True heading, its sigma and the convergence, as `grid.true_heading`."""
    x, y = r_e[:, 0], r_e[:, 1]
    distance = np.hypot(x, y)
    away = distance > 0.0
    p = np.where(away, distance, 1.0)
    sigma = np.where(away, np.hypot(sigma_grid, sigma_east / p), _CAP)
    known = sigma < _CAP
    u_z = earth.up(r_e)[:, 2]
    angle = np.arctan2(u_z * y, x)
    heading = np.mod(grid_heading + angle, 2.0 * np.pi)
    return (
        np.where(known, heading, np.nan),
        np.where(sigma >= _CAP, _CAP, sigma),
        np.where(known, angle, np.nan),
    )
