"""Scenes of both modes: a row's world without its fault, a filter's run in it, its errors.

`SinsScene` is the inertial vehicle (experiments/world.py), `StationScene` the vehicle without DVL
(experiments/station/world.py). Both have the same form for the judge.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import log
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.health.conditions import Health
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.error_model import X
from polar_nav_core.grid import ecef_to_grid
from polar_nav_sim.offline_station import StationScenario

from ...scoring.consistency import normalized_squared
from ..errors import track_errors
from ..schedule import FixSpec
from ..station.world import NS, StationWorld
from ..station.world import make_world as make_station_world
from ..station_choices import StationChoices
from ..world import World, make_world
from ..world_spec import WorldSpec
from .judge import Course, Deviation

_LOCAL = ('dvl', 'depth')
_OUTPUT_S = 1.0


class Ran(NamedTuple):
    """Result of a filter's run in either mode.

    ``local``, (n, 2, 3), are local statistics per row of the track (outputs.LOCAL_DOF).
    """

    params: EngineParams
    receipts: Sequence[Receipt]
    stamps_ns: np.ndarray
    local: Array
    divergence: str
    course: Course
    health: Sequence[Health] = ()


def _look_every_s(watched: bool) -> float:
    """Time between looks of the watchdog [s]; 0 for none."""
    return 1.0 if watched else 0.0


def _ran(
    params: EngineParams,
    result: engine_run.Result[engine_run.Track] | engine_run.Result[engine_run.StationTrack],
    course: Course,
) -> Ran:
    """Result of a run with the errors of its course."""
    track = result.track
    return Ran(
        params,
        result.receipts,
        track.stamps_ns,
        track.local_statistics,
        result.divergence,
        course,
        result.health,
    )


@dataclass(frozen=True)
class SinsScene:
    """An inertial vehicle with DVL, depth and late fixes.

    Attributes
    ----------
    world, fixes : WorldSpec, FixSpec
    changes : mapping
        Engine parameters that belong to the scene, for every filter.
    """

    world: WorldSpec
    fixes: FixSpec
    changes: Mapping[str, Any] = field(default_factory=dict)
    mode: str = 'sins'

    best: Mapping[str, Any] = field(
        default_factory=lambda: {
            'configuration': 'custom',
            'delay_handling': 'clone',
            'noise_adaptation': 'none',
            'gate_probability': 1.0,
            'max_fix_sigma': 0.0,
        }
    )
    """The exact filter without a gate, whose innovations show when a fault is visible."""

    @property
    def duration_s(self) -> float:
        """Length of a run [s]."""
        return self.world.duration_s

    def make(self, seed: int) -> World:
        """World of a seed without a fault."""
        return make_world(self.world, self.fixes, seed)

    def quiet(self, seed: int) -> World:
        """World without noise and constant errors, seen by a filter that expects them.

        Its innovations are zero to 1e-6 sigmas, so that those of a fault stand alone.
        """
        values = {f: getattr(self.world, f) for f in self.world.__dataclass_fields__}
        still = {'noisy': False, 'constants': 'none', 'initial_errors': 'none'}
        return make_world(WorldSpec(**{**values, **still}), self.fixes, seed)

    def run(self, world: World, changes: Mapping[str, Any], *, watched: bool = True) -> Ran:
        """Run a filter; ``changes`` are engine parameters. Health is looked at where watched."""
        params = self.params(world, changes)
        look_s = _look_every_s(watched)
        result = engine_run.run(params, world.inputs, states=9, look_every_s=look_s)
        return _ran(params, result, _sins_course(world, result.track, self.duration_s))

    def params(self, world: World, changes: Mapping[str, Any]) -> EngineParams:
        """Engine parameters of a filter in this scene."""
        longest = (
            {'max_delay_s': 61.0, 'history_s': 66.0} if self.fixes.longest_delay_s > 55 else {}
        )
        return world.params(**{'output_period_s': _OUTPUT_S, **longest, **self.changes, **changes})

    def smoothed(self, world: World, changes: Mapping[str, Any]) -> tuple[Course, str]:
        """Errors of the smoothed track, and why it is not settled; empty where it is."""
        params = self.params(world, changes)
        found = smoothing.smooth(params, world.inputs, covariances=True)
        return _sins_course(world, found.track, self.duration_s), found.unsettled

    def start_ns(self, world: World) -> int:
        """Stamp of the start of the run."""
        return world.truth.start_ns


def _sins_course(world: World, track: engine_run.Track, duration_s: float) -> Course:
    e = track_errors(world, track)
    C_e_G = ecef_to_grid(world.truth.state(track.stamps_ns).r_e) if len(e.time_s) else None
    P_r = e.P[:, X.dr_e, X.dr_e]
    if C_e_G is not None:
        P_r = np.einsum('nij,njk,nlk->nil', C_e_G, P_r, C_e_G)
    P_h = e.P[:, 2:3, 2:3]
    return Course(
        e.time_s,
        _deviation(e.dr_G, P_r),
        _deviation(e.phi_G[:, 2:], P_h),
        _deviation(e.dv_G, e.P[:, X.dv_G, X.dv_G]),
        duration_s,
    )


def _deviation(error: Array, P: Array) -> Deviation:
    variance = np.diagonal(P, axis1=1, axis2=2)
    with np.errstate(invalid='ignore'):
        sigma = np.sqrt(variance)
    return Deviation(error, np.asarray(sigma), normalized_squared(error, P) / error.shape[1])


@dataclass(frozen=True)
class StationScene:
    """A vehicle without DVL that a hydroacoustic station locates.

    Attributes
    ----------
    scenario : StationScenario
    changes : mapping
        Engine parameters that belong to the scene, for every filter.
    """

    scenario: StationScenario
    changes: Mapping[str, Any] = field(default_factory=dict)
    mode: str = 'station'

    best: Mapping[str, Any] = field(default_factory=dict)
    """Station mode's default is exact: rewind with a gate and robust weights."""

    @property
    def duration_s(self) -> float:
        """Length of a run [s]."""
        return self.scenario.duration_s

    def make(self, seed: int) -> StationWorld:
        """World of a seed without a fault."""
        return make_station_world(self.scenario, seed, StationChoices().depth_sigma, 0.0)

    def quiet(self, seed: int) -> StationWorld:
        """World of the seed: noise of packets is quantized, a second difference takes it out."""
        return self.make(seed)

    def run(self, world: StationWorld, changes: Mapping[str, Any], *, watched: bool = True) -> Ran:
        """Run a filter; ``changes`` are engine parameters. Health is looked at where watched."""
        params = self.params(world, changes)
        result = engine_run.run(params, world.inputs, look_every_s=_look_every_s(watched))
        return _ran(params, result, _station_course(world, result.track, self.duration_s))

    def params(self, world: StationWorld, changes: Mapping[str, Any]) -> EngineParams:
        """Engine parameters of a filter in this scene."""
        values = {'output_period_s': _OUTPUT_S, **self.changes, **changes}
        return world.params(StationChoices(), 0.0, **values)

    def smoothed(self, world: StationWorld, changes: Mapping[str, Any]) -> tuple[Course, str]:
        """Errors of the smoothed track, and why it is not settled; empty where it is."""
        found = smoothing.smooth(self.params(world, changes), world.inputs)
        return _station_course(world, found.track, self.duration_s), found.unsettled

    def start_ns(self, world: StationWorld) -> int:
        """Stamp of the start of the run."""
        return world.run.start_ns


def _station_course(
    world: StationWorld, track: engine_run.StationTrack, duration_s: float
) -> Course:
    run = world.run
    row = np.searchsorted(run.t_s, (track.stamps_ns - run.start_ns) / NS - 1e-6)
    row = np.minimum(row, len(run.t_s) - 1)
    C = world.C_e_S
    position = ((track.r_e - world.origin_e) @ C.T - run.p[row])[:, :2]
    P_r = np.einsum('ij,njk,lk->nil', C, track.P[:, X.dr_e, X.dr_e], C)[:, :2, :2]
    velocity = (track.v_G - run.v[row])[:, :2]
    phi = -log(track.C_b_G @ np.swapaxes(run.true_C_b_G[row], 1, 2))
    return Course(
        np.asarray(run.t_s[row]),
        _deviation(position, P_r),
        _deviation(phi[:, 2:], track.P[:, 2:3, 2:3]),
        _deviation(velocity, track.P[:, 3:5, 3:5]),
        duration_s,
    )


Scene = SinsScene | StationScene


def refused_shares(ran: Ran) -> dict[str, float]:
    """Share of the measurements that the gate refused, by sensor: last verdicts of fixes."""
    last = {(r.source, r.sequence): r for r in ran.receipts if r.source}
    judged = [r.verdict.name for r in last.values() if r.verdict.name in ('FUSED', 'GATED')]
    out = {'refused_fix': judged.count('GATED') / len(judged)} if judged else {}
    used, gated = ran.local[:, :, 0].sum(axis=0), ran.local[:, :, 1].sum(axis=0)
    for row, name in enumerate(_LOCAL):
        if used[row] + gated[row]:
            out[f'refused_{name}'] = float(gated[row] / (used[row] + gated[row]))
    return out
