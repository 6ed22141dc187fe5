"""Fusion of measurements in SINS mode: local ones at once, late fixes by a strategy.

All strategies work on the same filter. The forward ones bring the fix to the present; `rewind`
goes back to the state before the fix, takes it, and processes the stored inputs again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ... import earth
from ...arrays import Array
from ...identification.result import Identification
from ...kernels.sins import rows as filter_rows
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...kernels.sins.measured import fill_shared
from ..away import TURN_OVER_S, WANDER_OVER_S, turn_rate, wander
from ..driver import Driver
from ..events import ControlSample, DepthSample, Fix, HeadingSample, ImuSample, InitialState, Local
from ..level import degrees_of_freedom, levelled
from ..outputs import Estimate, ModelEstimate
from ..params import EngineParams
from ..results import FixResult, Outcome
from ..saved import SavedState
from . import doubt
from .adaptation import make_noise, make_process
from .adapted import fuse_adapted
from .filter import NavigationFilter
from .history import Epoch
from .resume import WANDER, save_state
from .rows import fill_common, fill_dvl, fill_late_fix, innovation_covariance, refer_to_now
from .streams import put_late_fix
from .turned import free_since_ns


class Fusion:
    """The SINS filter with its measurements; each subclass is a strategy for late fixes.

    Parameters
    ----------
    params : EngineParams
        Sensors, noise, configuration.
    initial : InitialState
        State to start from.
    stamp_ns : int
        When it holds.
    """

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        configuration = params.resolved()
        adaptation = configuration.noise_adaptation
        self.filter = self.make_filter(params, initial, stamp_ns)
        self._wander: Array = np.zeros(2)
        if isinstance(initial, SavedState):
            self._wander = initial.values[WANDER]
        bounds = (params.adaptive_floor, params.adaptive_ceiling)
        self._as_printed = adaptation in ('sage_husa_unguarded', 'sage_husa_published')
        self._noise_fix = make_noise(adaptation, params.forgetting, *bounds)
        self._noise_dvl = make_noise(adaptation, params.forgetting, *bounds)
        self.filter.process = make_process(adaptation, params.forgetting)
        if self._noise_fix is not None:
            self._noise_fix.robust = configuration.robust_fixes

    def make_filter(
        self, params: EngineParams, initial: InitialState, stamp_ns: int
    ) -> NavigationFilter:
        """Filter with the stored past that the strategy needs."""
        return NavigationFilter(params, initial, stamp_ns)

    @property
    def takes_fixes(self) -> bool:
        """Whether `advance` fuses late fixes that stand in the streams."""
        return self.filter.settings.back_propagates

    def advance(self, until_ns: int, until_rank: int) -> int:
        """Process what stands in the streams before a place; FULL, STOPPED or DONE."""
        return self.filter.advance(until_ns, until_rank)

    def put(self, fix: Fix) -> None:
        """Append a fix to the streams, at its stamp of reception."""
        put_late_fix(self.filter.streams, fix, self.filter.leader.split(fix))

    def settled(self, fixes: Sequence[Fix], outcomes: Array) -> None:
        """Do nothing about fixes in the streams that were decided; rows of ``fix_outcomes``."""

    def imu(self, sample: ImuSample) -> None:
        """Advance by one IMU sample."""
        self.filter.imu(sample)

    def local(self, event: Local) -> Outcome:
        """Fuse a ping, depth or heading as valid now; returns the outcome of the update."""
        if isinstance(event, DepthSample):
            return self.filter.depth(event)
        if isinstance(event, HeadingSample):
            return self.filter.heading(event)
        if event.water:
            return self.filter.water_ping(event)
        if self._noise_dvl is None:
            return self.filter.dvl(event)
        self.filter.reach(event.stamp_ns)
        fill_dvl(self.filter, event)
        return fuse_adapted(self.filter, 3, self._noise_dvl, fs.DVL_ROW)

    def begin(self, sample: ImuSample) -> None:
        """Start at the sample whose interval ends at the stamp of the initial state."""

    def control(self, sample: ControlSample) -> None:
        """Store the thrust that holds from its stamp on; ignored without a vehicle model."""
        if self.filter.settings.aiding.on:
            self.filter.control(sample)

    def model(self) -> ModelEstimate | None:
        """Estimated drag and current; None without a vehicle model."""
        return self.filter.model_estimate()

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix; None when the stored history does not reach back to its validity."""
        raise TypeError(f'{type(self).__name__} has no way to treat fix {fix.sequence}')

    def _fuse(self) -> Outcome:
        """Fuse the fix in the filter's ``H``, ``R``, ``z``; returns the outcome."""
        if self._noise_fix is None:
            return self.filter.fuse_fix()
        return fuse_adapted(self.filter, 3, self._noise_fix, fs.FIX_ROW)

    @property
    def replaced_ns(self) -> int:
        """Stamp before which the track was another one, that fixes replaced [ns]; 0 for none."""
        return int(self.filter.state.counters[fs.FROM_NS])

    def oldest_ns(self) -> int:
        """Oldest validity stamp [ns] at which a fix can still be fused."""
        return self.filter.history.reaches_ns()

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample."""
        return self.filter.stamp_ns

    def offset(self, fix: Fix) -> tuple[Array, float] | None:
        """Fix minus estimate at its validity, grid axes [m], and its NIS by the covariance now.

        Common errors are in it, as in that of the gate.
        """
        f = self.filter
        epoch = f.history.before(fix.validity_ns)
        if epoch is None:
            return None
        ahead_e = epoch.velocity_e * ((fix.validity_ns - epoch.stamp_ns) * 1e-9)
        offset_e: Array = fix.r_e - (epoch.point_e + ahead_e)
        S, L = innovation_covariance(f, fix), np.zeros((3, 3))
        if not kf.cholesky(L, S, 3):
            return None
        offset_G = np.einsum('ij,j->i', f.frames.C_e_G, offset_e)
        return levelled(offset_G, fix), float(kf.nis_of(L, offset_G, np.zeros(3), 3))

    def widened(self, fix: Fix) -> Fix:
        """Fix whose covariance has what the vehicle moves in the 1-sigma of its delay.

        An error dt of the time of validity displaces it by v dt, with the velocity v of then.
        """
        if fix.delay_sigma <= 0.0:
            return fix
        epoch = self.filter.history.before(fix.validity_ns)
        v_e = self.filter.frames.velocity_e if epoch is None else epoch.velocity_e
        moved = fix.delay_sigma * v_e
        return fix.believed_to(fix.covariance_e + np.outer(moved, moved))

    def doubt_position(self, distance: float) -> None:
        """Let the position be off by ``distance`` [m], uncorrelated with everything else."""
        doubt.doubt_position(self.filter, distance)
        self.forget_past()

    def doubt_all(self, factor: float) -> None:
        """Enlarge the covariance by a factor, within limits; its correlations stay."""
        doubt.inflate(self.filter, factor)
        self.forget_past()

    def contradict(self, offset_G: Array, speed_G: Array) -> None:
        """Let the published covariance reach to where refused fixes say that the vehicle is."""
        if offset_G.any() or self.filter.state.conflict.any():
            doubt.contradict(self.filter, offset_G, speed_G)

    def forget_past(self) -> None:
        """Do nothing: what is stored of the past stays usable. `Rewind` ends it here."""

    def saved(self, fixes: tuple[int, int, int], records: tuple[bytes, bytes]) -> SavedState:
        """State as it is now, with its fixes, to go on from after a restart."""
        return save_state(
            self.filter.state,
            turn_rate(*self._velocities(TURN_OVER_S)),
            wander(*self._velocities(WANDER_OVER_S), self._wander),
            self.filter.leader,
            fixes,
            records,
            heading=self.filter.settings.heading.on,
            free_since_ns=free_since_ns(self.filter),
        )

    def _velocities(self, length_s: float) -> tuple[Array, Array]:
        """Times (n,) [s] and velocities (n, 3) of the last seconds, grid axes [m/s]."""
        f = self.filter
        since_ns = max(f.stamp_ns - round(length_s * 1e9), f.start_ns)
        stamps, v_G = f.history.velocities_since(since_ns)
        return np.asarray(stamps * 1e-9, dtype=np.float64), v_G

    def height(self) -> float:
        """Height of the vehicle above the ellipsoid [m]."""
        return float(earth.geodetic_from_ecef(self.filter.state.r_e)[2])

    def adapt(self, identified: Identification) -> None:
        """Do nothing: this mode adapts no drag or current from an identification."""

    def restore(self, lost: Driver) -> bool:
        """Begin with the newest sound state of a fusion that was lost.

        The filters as they were printed are expected to diverge: they stop.
        """
        if not isinstance(lost, Fusion) or self._as_printed:
            return False
        self.filter.restore(lost.filter)
        return True

    def estimate(self, fixes: tuple[int, int, int]) -> Estimate:
        """Estimate at the newest IMU sample; ``fixes`` are received, fused, newest validity."""
        f, s = self.filter, self.filter.state
        hidden = f.settings.shares_leader or f.settings.heading.on
        return Estimate(
            stamp_ns=f.stamp_ns,
            r_e=s.r_e.copy(),
            v_G=s.v_G.copy(),
            C_b_G=s.C_b_G.copy(),
            P=f.published_P,
            gyro_bias_b=s.b_gyro_b.copy(),
            accel_bias_b=s.b_accel_b.copy(),
            dvl_scale_m=s.dvl_scale_m.copy(),
            dvl_markov_m=s.dvl_markov_m.copy(),
            usbl_bias_a=np.zeros(3) if hidden else s.usbl_bias_a.copy(),
            fixes_received=fixes[0],
            fixes_fused=fixes[1],
            last_validity_ns=fixes[2],
            local_statistics=f.taken_local_statistics(),
            model=self.model(),
        )

    def _fuse_at(self, fix: Fix, epoch: Epoch, stamp_ns: int) -> None:
        """Fill ``H``, ``R``, ``z`` with the fix against the position at an epoch plus v dt."""
        f = self.filter
        split = f.leader.split(fix)
        fill_shared(f.work.C_a_G, f.settings, f.frames.C_e_G, fix.array_heading, split.common_e)
        point_e: Array = epoch.point_e + epoch.velocity_e * ((stamp_ns - epoch.stamp_ns) * 1e-9)
        filter_rows.fix_rows(
            f.work.H,
            f.work.R,
            f.work.z,
            f.frames.C_e_G,
            epoch.lever_G,
            point_e,
            fix.r_e,
            split.covariance_e,
            f.work.C_a_G,
            epoch.usbl_bias_a,
        )
        fill_common(f, fix, split.common_e)
        f.work.dof[0] = degrees_of_freedom(fix)
        f.work.age[0] = (f.stamp_ns - fix.validity_ns) * 1e-9

    def _present(self) -> Epoch:
        """Newest epoch, with the corrections since."""
        f = self.filter
        return replace(
            f.history.newest(),
            point_e=f.frames.point_e,
            velocity_e=f.frames.velocity_e,
            lever_G=f.frames.lever_G,
            usbl_bias_a=f.state.usbl_bias_a,
            correction=f.history.correction,
        )


class Ignore(Fusion):
    """Fix treated as valid at reception: the conventional filter, off by speed times delay."""

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix as if it were valid when it was received."""
        self.filter.reach(fix.receive_ns)
        self._fuse_at(fix, self._present(), fix.receive_ns)
        return FixResult(self._fuse(), 0)


class Tagged(Fusion):
    """Innovation at the time of validity, applied to the present with the rows of the present."""

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix with the innovation at its validity and the rows of the present state."""
        f = self.filter
        f.reach(fix.receive_ns)
        epoch = f.history.before(fix.validity_ns)
        if epoch is None:
            return None
        self._fuse_at(fix, epoch, fix.validity_ns)
        refer_to_now(f, epoch.correction)
        return FixResult(self._fuse(), f.history.step - epoch.step)


class BackPropagate(Fusion):
    """Innovation at validity with H* = H Phi^-1: the published modified AKF, in closed loop."""

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix with its rows referred to now through the stored transitions."""
        self.filter.reach(fix.receive_ns)
        steps = fill_late_fix(self.filter, fix)
        return None if steps < 0 else FixResult(self._fuse(), steps)
