"""Fast replay of a run in station mode from arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import nav_columns
from polar_nav_core.arrays import Array
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.outputs import ModelEstimate
from polar_nav_core.engine.track import StationTrack, Track
from polar_nav_core.error_model import X
from polar_nav_core.identification.result import Identification
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.stamps import NS

from ..series.estimates import EstimateRows, receipts_of
from ..series.model import Identified, ModelRun, ModelSeries, identified_of_engine
from ..series.vehicle import Floats
from .arrays import StationArrays
from .result import LOOK_EVERY_S, ReplayedRun

_ROWS = 512


def replay_station(source: StationArrays, params: FollowerParams) -> ReplayedRun:
    """Replayed run of a follower's recorded arrays in station mode."""
    result = engine_run.run(
        params, source.inputs(params), commands=source.commands, look_every_s=LOOK_EVERY_S
    )
    track = result.track
    rows = EstimateRows(params, len(track.stamps_ns))
    rows.append(as_track(track))
    return ReplayedRun(
        vehicle=source.vehicle,
        params=params,
        taken=source.taken,
        estimates=rows.series(source.vehicle),
        receipts=receipts_of(result.receipts),
        verdicts={v.name: n for v, n in sorted(result.verdicts.items()) if n},
        divergence=result.divergence,
        health=result.health,
        model=model_run(track, result.identifications, params),
    )


def as_track(track: StationTrack) -> Track:
    """Track in the form of the other mode, with derived columns.

    NaN where this mode estimates nothing.
    """
    n = len(track.stamps_ns)
    parts = [slice(k, k + _ROWS) for k in range(0, n, _ROWS)]
    derived = [_derived(track, part) for part in parts]
    return Track(
        stamps_ns=track.stamps_ns,
        r_e=track.r_e,
        v_G=track.v_G,
        C_b_G=track.C_b_G,
        P=np.zeros((0, X.size, X.size)),
        sensor_errors=np.full((n, 15), np.nan),
        local_statistics=track.local_statistics,
        fixes=track.fixes,
        derived=np.concatenate(derived) if derived else np.zeros((0, nav_columns.WIDTH)),
    )


def _derived(track: StationTrack, part: slice) -> Array:
    own = track.P[part]
    P = np.full((len(own), X.size, X.size), np.nan)
    P[:, : own.shape[1], : own.shape[2]] = own
    return nav_columns.describe(track.r_e[part], track.C_b_G[part], P)


def model_run(
    track: StationTrack, identifications: tuple[Identification, ...], params: FollowerParams
) -> ModelRun | None:
    """Model estimates at the first row of each second, as a session publishes them."""
    seconds = track.stamps_ns // NS
    if not len(seconds):
        return None
    first = np.flatnonzero(np.r_[True, seconds[1:] != seconds[:-1]])
    estimates = [track.model(int(k), params) for k in first]
    found: tuple[Identified, ...] = tuple(identified_of_engine(i) for i in identifications)
    return ModelRun(_series(track.stamps_ns[first], estimates), found)


def _series(stamp_ns: NDArray[np.int64], estimates: list[ModelEstimate]) -> ModelSeries:
    def column(name: str) -> Floats:
        return np.array([getattr(one, name) for one in estimates], dtype=np.float64)

    return ModelSeries(
        stamp_ns=stamp_ns,
        v_r_b=column('v_r_b'),
        P_v_r_b=column('v_r_covariance_b'),
        current_G=column('current_G'),
        P_current_G=column('current_covariance_G'),
        drag_linear=column('drag_linear'),
        drag_linear_sigma=column('drag_linear_sigma'),
        drag_quadratic=column('drag_quadratic'),
        drag_quadratic_sigma=column('drag_quadratic_sigma'),
        drag_correlation=column('drag_correlation'),
        heading_bias=column('heading_bias'),
        heading_bias_sigma=column('heading_bias_sigma'),
        current_walk=column('current_walk'),
    )
