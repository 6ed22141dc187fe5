"""Files of trajectories for other tools: TUM (evo, rpg_trajectory_evaluation), CSV and KML.

In: truth or estimates as series. Out: one line per sample, in order of stamps, numbers so that
reading them back gives the same float64.

TUM: ``time x y z qx qy qz qw``, time in seconds as decimal text of the integer stamp, pose of
base_link in the chosen frame. Frames:

- ``ecef``: earth axes (C_b_e).
- ``grid``: grid axes and grid plane at the origin, the trajectory's first position unless another
  is given: x grid east, y grid north, z up, fixed to the earth.
- ``enu``: true east, north, up at the origin, fixed to the earth. At a pole itself there is no
  east; near it the axes depend on where exactly the origin is.
- ``epsg:3413``, ``epsg:3995``, ``epsg:3031``: polar stereographic maps (`projection`).

KML (`kml`) has longitude, latitude and height, and no frame.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from polar_nav_core.attitude import quaternion_from_matrix
from polar_nav_core.earth import ecef_to_enu, geodetic_from_ecef
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.user_files import writing

from ..series.vehicle import EstimateSeries, Floats, Ints, TruthSeries
from .kml import kml_lines
from .projection import PROJECTIONS, projected

FRAMES = ('ecef', 'enu', 'grid', *PROJECTIONS)
FORMATS = ('tum', 'csv', 'kml')
_NS = 1_000_000_000


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of base_link in earth axes.

    Attributes
    ----------
    stamp_ns : ndarray of int64, shape (n,)
    r_e : ndarray, shape (n, 3)
        ECEF [m].
    C_b_e : ndarray, shape (n, 3, 3)
    v_e : ndarray, shape (n, 3)
        Velocity over ground, earth axes [m/s].
    sigma_G : ndarray, shape (n, 3), or None
        Stated 1-sigma of the position, grid axes at the vehicle [m]; None for truth.
    latitude, longitude, height : ndarray, shape (n,)
        [rad, rad, m].
    left_out : int
        Samples without a position or an attitude.
    """

    stamp_ns: Ints
    r_e: Floats
    C_b_e: Floats
    v_e: Floats
    sigma_G: Floats | None
    latitude: Floats
    longitude: Floats
    height: Floats
    left_out: int

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.stamp_ns)


def trajectory(series: TruthSeries | EstimateSeries) -> Trajectory:
    """Poses of a series in order of stamps; samples without a pose are left out and counted."""
    known = np.isfinite(series.r_e).all(1) & np.isfinite(series.C_b_G).all((1, 2))
    order = np.flatnonzero(known)[np.argsort(series.stamp_ns[known], kind='stable')]
    s = series.rows(order)
    C_G_e = np.swapaxes(ecef_to_grid(s.r_e), 1, 2) if len(s) else np.empty((0, 3, 3))
    sigma = None
    if isinstance(s, EstimateSeries):
        sigma = np.sqrt(np.diagonal(s.P_position_G, axis1=1, axis2=2))
    return Trajectory(
        stamp_ns=s.stamp_ns,
        r_e=s.r_e,
        C_b_e=C_G_e @ s.C_b_G,
        v_e=np.einsum('nij,nj->ni', C_G_e, s.v_G),
        sigma_G=sigma,
        latitude=s.latitude,
        longitude=s.longitude,
        height=s.height,
        left_out=len(series) - len(s),
    )


def axes(frame: str, origin_r_e: Floats) -> tuple[Floats, Floats]:
    """Origin and C_e_f of a frame.

    Raises
    ------
    ConfigError
        For an unknown frame, and for ``enu`` at a pole.
    """
    if frame == 'ecef':
        return np.zeros(3), np.eye(3)
    if frame == 'grid':
        return origin_r_e, ecef_to_grid(origin_r_e)
    if frame == 'enu':
        if np.hypot(origin_r_e[0], origin_r_e[1]) < 1.0:
            raise ConfigError('frame enu: within 1 m of the pole there is no east; use grid')
        latitude, longitude, _ = geodetic_from_ecef(origin_r_e)
        return origin_r_e, ecef_to_enu(latitude, longitude)
    raise ConfigError(f'frame {frame!r} is none of {", ".join(FRAMES)}')


def write_trajectory(
    path: Path,
    track: Trajectory,
    *,
    kind: str = 'tum',
    frame: str = 'ecef',
    origin_r_e: Floats | None = None,
) -> None:
    """Write a trajectory to a new file.

    Parameters
    ----------
    path : Path
        Must not exist.
    track : Trajectory
    kind : {'tum', 'csv', 'kml'}
    frame : str
        One of `FRAMES`; KML has none.
    origin_r_e : ndarray, shape (3,), optional
        Origin of a local frame, so that several files share one; first position by default.

    Raises
    ------
    ConfigError
        For another kind or frame, and for a trajectory without a pose.
    """
    if kind not in FORMATS:
        raise ConfigError(f'format {kind!r} is none of {", ".join(FORMATS)}')
    if not len(track):
        raise ConfigError(f'{path}: there is no pose to write')
    if kind == 'kml' and frame != 'ecef':
        raise ConfigError(f'{path}: KML has longitudes and latitudes, no frame {frame}')
    if frame in PROJECTIONS:
        r_f, C_e_f = projected(frame, track.r_e)
        v_f = np.einsum('nij,nj->ni', C_e_f, track.v_e)
    else:
        origin, C_e_f = axes(frame, track.r_e[0] if origin_r_e is None else origin_r_e)
        r_f, v_f = (track.r_e - origin) @ C_e_f.T, track.v_e @ C_e_f.T
    q = quaternion_from_matrix(C_e_f @ track.C_b_e)
    with writing(path):
        stream = path.open('x', encoding='utf-8', newline='')
        try:
            with stream:
                if kind == 'kml':
                    place = (track.longitude, track.latitude, track.height)
                    stream.writelines(kml_lines(path.stem, track.stamp_ns, *place))
                elif kind == 'tum':
                    stream.writelines(_tum(track.stamp_ns, r_f, q))
                else:
                    _csv(stream, track, r_f, q, v_f)
        except OSError:
            path.unlink(missing_ok=True)  # half a trajectory looks like a whole one
            raise


def _tum(stamp_ns: Ints, r_f: Floats, q: Floats) -> Iterator[str]:
    for stamp, r, xyzw in zip(stamp_ns.tolist(), r_f.tolist(), q.tolist(), strict=True):
        yield f'{seconds_text(stamp)} {_numbers(r)} {_numbers(xyzw)}\n'


def _numbers(values: Sequence[float]) -> str:
    return ' '.join(map(repr, values))


def _csv(stream: TextIO, track: Trajectory, r_f: Floats, q: Floats, v_f: Floats) -> None:
    names = ['stamp_ns', 'x_m', 'y_m', 'z_m', 'qx', 'qy', 'qz', 'qw', 'vx_mps', 'vy_mps', 'vz_mps']
    names += ['latitude_deg', 'longitude_deg', 'height_m']
    place = np.column_stack(
        [np.rad2deg(track.latitude), np.rad2deg(track.longitude), track.height]
    )
    parts = [r_f, q, v_f, place]
    if track.sigma_G is not None:
        names += ['sigma_grid_east_m', 'sigma_grid_north_m', 'sigma_up_m']
        parts.append(track.sigma_G)
    writer = csv.writer(stream, lineterminator='\n')
    writer.writerow(names)
    values = np.column_stack(parts).tolist()
    for stamp, row in zip(track.stamp_ns.tolist(), values, strict=True):
        writer.writerow([stamp, *map(repr, row)])


def seconds_text(stamp_ns: int) -> str:
    """Seconds of an integer stamp, exactly."""
    sign, size = ('-', -stamp_ns) if stamp_ns < 0 else ('', stamp_ns)
    return f'{sign}{size // _NS}.{size % _NS:09d}'
