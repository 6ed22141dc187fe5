"""Errors of a track against the truth of its world, and their NEES.

Signs are those of docs/frames.md: estimate minus truth for the navigation state, truth minus
estimate for the sensor errors (what is left after correction).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import log
from polar_nav_core.engine.inputs import Stamps
from polar_nav_core.engine.track import Track
from polar_nav_core.error_model import X
from polar_nav_core.grid import ecef_to_grid

from ..scoring.consistency import normalized_squared
from .world import World

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class TrackErrors:
    """Errors of n estimates.

    Attributes
    ----------
    time_s : (n,) array
        Since the start of the mission [s].
    phi_G, dv_G, dr_G : (n, 3) arrays
        [rad], [m/s], [m], grid axes.
    along, cross : (n,) arrays
        Horizontal position error along the true velocity and to its left [m].
    state : (n, 24) array
        The filter's error state, position in ECEF axes.
    P : (n, 24, 24) array
        Its covariance as stated by the filter; of the leading states where the run kept no more,
        and then :meth:`nees` has no meaning.
    """

    time_s: Array
    phi_G: Array
    dv_G: Array
    dr_G: Array
    along: Array
    cross: Array
    state: Array
    P: Array

    @property
    def horizontal(self) -> Array:
        """Horizontal position error [m], shape (n,)."""
        return np.asarray(np.hypot(self.dr_G[:, 0], self.dr_G[:, 1]))

    def nees(self) -> Array:
        """Normalized squared error over all states whose prior is not zero, shape (n,)."""
        keep = np.flatnonzero(np.diagonal(self.P, axis1=1, axis2=2).max(axis=0) > 0.0)
        return normalized_squared(self.state[:, keep], self.P[:, keep][:, :, keep])

    def nees_dof(self) -> int:
        """Number of states that :meth:`nees` counts."""
        return int(np.count_nonzero(np.diagonal(self.P, axis1=1, axis2=2).max(axis=0) > 0.0))

    def nees_position(self) -> Array:
        """Normalized squared error of position (3 components), shape (n,)."""
        rows = X.dr_e
        return normalized_squared(self.state[:, rows], self.P[:, rows, rows])

    def rows(self, choice: NDArray[np.bool_]) -> TrackErrors:
        """Errors of the estimates that `index` selects."""
        return TrackErrors(*(getattr(self, name)[choice] for name in self.__dataclass_fields__))


def track_errors(world: World, track: Track) -> TrackErrors:
    """Errors of a track against its world's truth."""
    truth = world.truth.state(track.stamps_ns)
    C_e_G = ecef_to_grid(truth.r_e)
    dr_e = track.r_e - truth.r_e
    dr_G = np.einsum('nij,nj->ni', C_e_G, dr_e)
    # Chat C' = exp(-[phi x]).
    phi_G = -log(track.C_b_G @ np.swapaxes(truth.C_b_G, 1, 2))
    dv_G = track.v_G - truth.v_G
    way = truth.v_G[:, :2] / np.linalg.norm(truth.v_G[:, :2], axis=1)[:, None]
    state = np.zeros((len(dr_e), X.size))
    state[:, X.phi_G], state[:, X.dv_G], state[:, X.dr_e] = phi_G, dv_G, dr_e
    state[:, X.b_gyro_b.start :] = _true_sensor_errors(world, track.stamps_ns)
    state[:, X.b_gyro_b.start :] -= track.sensor_errors
    return TrackErrors(
        time_s=np.asarray((track.stamps_ns - world.truth.start_ns) * 1e-9, dtype=np.float64),
        phi_G=phi_G,
        dv_G=dv_G,
        dr_G=dr_G,
        along=np.einsum('ni,ni->n', dr_G[:, :2], way),
        cross=dr_G[:, 1] * way[:, 0] - dr_G[:, 0] * way[:, 1],
        state=state,
        P=track.P,
    )


def _true_sensor_errors(world: World, stamps: Stamps) -> Array:
    """True sensor errors at the stamps, shape (n, 15); the DVL's as of the last ping."""
    out = np.zeros((len(stamps), 15))
    out[:, 0:3] = world.constants.gyro_bias_b
    out[:, 3:6] = world.constants.accel_bias_b
    out[:, 6:9] = world.constants.dvl_scale_m
    if len(world.dvl_markov_m):
        last = np.searchsorted(world.inputs.dvl_stamps_ns, stamps, side='right') - 1
        out[:, 9:12] = world.dvl_markov_m[np.maximum(last, 0)]
    return out
