"""Strapdown state and error covariance of a vehicle at one stamp, in closed loop.

Events come in order. An IMU sample moves the state; when it ends a covariance step, the covariance
follows. A measurement corrects the state at once, with the covariance of the last step at or
before it: steps are never split. All of that is compiled (kernels.sins.events); this class holds
the arrays, and does the part that is not compiled.
"""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...error_model import X
from ...errors import FilterDivergence
from ...kernels.sins import bridge, consider, output
from ...kernels.sins import events as fe
from ...kernels.sins import fuse as ff
from ...kernels.sins import run as filter_run
from ...kernels.sins import state as fs
from ...kernels.sins import update as kf
from ...kernels.sins.rings import Log, Past
from ...kernels.sins.settings import Settings
from ...kernels.sins.work import Work, make_work
from ...machine_code import Direct
from ...order import NEVER_NS
from ..events import (
    ControlSample,
    DepthSample,
    DvlPing,
    HeadingSample,
    ImuSample,
    InitialState,
)
from ..outputs import ModelEstimate
from ..params import EngineParams
from ..results import CORRECTIONS_PER_S, IMU_PERIOD_S, Outcome
from ..saved import SavedState
from . import aiding
from . import streams as st
from .first_state import heading_sigmas, restore, set_out
from .history import History, make_past
from .leader import LeaderError
from .log import STEPS_PER_BLOCK, make_log
from .noise import ProcessNoise
from .resume import note_before, resume
from .settings import make_settings

_WHY = {
    fs.P_NOT_DEFINITE: 'the covariance of the filter is no longer positive definite',
    fs.S_NOT_DEFINITE: 'an innovation covariance is not positive definite',
}


class NavigationFilter:
    """Compiled 24-state error filter on a SINS: state, covariance and stored past of one vehicle.

    Parameters
    ----------
    params : EngineParams
        Sensors, noise, periods.
    initial : InitialState
        State and its 1-sigma values.
    stamp_ns : int
        When that holds.
    steps, snapshots : bool
        Whether to log linear steps (for `clone`) and to take snapshots (for `rewind`).
    states_every : int
        Steps from one snapshot to the next (for a tape), where they are not those of `rewind`.
    late : bool
        Whether fixes may come late. Of what only those want, the newest is enough else.
    """

    def __init__(
        self,
        params: EngineParams,
        initial: InitialState,
        stamp_ns: int,
        *,
        steps: bool = False,
        snapshots: bool = False,
        states_every: int = 0,
        late: bool = True,
    ) -> None:
        self._p = params
        model = params.model_aiding
        self.state = fs.make_state(model=model)
        self.frames = fs.make_frames()
        self.work = make_work()
        self.settings = make_settings(params, initial, stamp_ns)
        if states_every:
            self.settings = self.settings._replace(steps_per_snapshot=states_every)
        shares = self.settings.shares_leader
        self.leader = LeaderError(
            params.leader_error_tau if shares else 0.0,
            keeps=params.leader_link == 'kept',
            shaped=params.leader_shape == 'way',
        )
        # The block that the oldest fix belongs to begins before it, after a step.
        block_s = (STEPS_PER_BLOCK + 2) * params.filter_period_s
        length_s = params.history_s + (block_s if steps else 0.0)
        self.past = make_past(length_s, params.filter_period_s, model=model, late=late)
        self.log = make_log(
            self.past,
            steps=steps,
            snapshots=self.settings.steps_per_snapshot if snapshots or states_every else 0,
            model=model,
            late=late,
        )
        self.history = History(self.past, self.state)
        kept_s = params.history_s if snapshots else 0.0
        self.streams = st.live_streams(kept_s, 1.0 / IMU_PERIOD_S, CORRECTIONS_PER_S)
        self.rows = output.NO_ROWS
        self._run = Direct(filter_run.advance)
        self.process: ProcessNoise | None = None
        if isinstance(initial, SavedState):
            sigmas = heading_sigmas(self.settings) if self.settings.heading.on else None
            resume(self.state, self.leader, params, initial, stamp_ns, sigmas)
        else:
            set_out(self.state, self.settings, params, initial)
        weight = params.forgetting ** (1.0 / (1.0 - params.forgetting))  # b^k with k = k0
        self.state.noise[:] = [weight, 1.0, 1.0, 1.0]
        self.start_ns = stamp_ns
        self.begin()
        if isinstance(initial, SavedState):
            note_before(self.state, initial)

    def begin(self) -> None:
        """Begin at the state as it is: no past, one epoch, one snapshot."""
        stamp_ns, counters, log = self.start_ns, self.state.counters, self.log
        counters[:] = 0
        log.counts[:] = 0
        opened = range(fs.OPENED_NS, fs.OPENED_NS + 3)
        for k in (
            fs.STAMP,
            fs.IMU_NS,
            fs.IMPULSE_NS,
            fs.LOCK_NS,
            *opened,
            fs.HEADING_OPENED_NS,
        ):
            counters[k] = stamp_ns
        drifts = self.state.sensitivity[:, consider.LEADER :].any()
        counters[fs.CONSIDERS] = self.settings.considers or drifts
        fe.begin_step(self.state, self.settings, stamp_ns)
        ff.locate(self.state, self.frames, self.settings)
        fe.add_epoch(self.state, self.settings, self.past)
        if len(log.step_P):
            log.step_P[0] = self.state.P
            log.stamps[0] = stamp_ns
            log.epochs[0] = 0
            log.counts[0] = 1
        fe.take_snapshot(self.state, log)
        log.good_flat[0] = np.concatenate([self.state.flat, self.state.model.ravel()])
        log.good_ns[0] = stamp_ns

    def restore(self, lost: NavigationFilter) -> None:
        """Begin with the newest sound state of a filter that was lost, moved on and enlarged.

        Correlations are dropped: they may be what was lost.
        """
        since_s = max(0.0, (self.start_ns - int(lost.log.good_ns[0])) * 1e-9)
        restore(self.state, self.frames, self.settings, lost.log.good_flat[0], since_s)
        self.leader = lost.leader  # the states are scaled by what it has heard
        self.begin()

    @property
    def stamp_ns(self) -> int:
        """Stamp of the state."""
        return int(self.state.counters[fs.STAMP])

    @property
    def considers(self) -> bool:
        """Whether common errors are considered."""
        return bool(self.state.counters[fs.CONSIDERS])

    @property
    def estimates_usbl_bias(self) -> bool:
        """Whether the last three states, the USBL bias, are estimated."""
        return self.settings.estimates_usbl_bias

    @property
    def parts(self) -> tuple[fs.State, fs.Frames, Settings, Past, Work, Log]:
        """The first arguments of most kernels: state, stored past and scratch, in their order."""
        return self.state, self.frames, self.settings, self.past, self.work, self.log

    # -- events -----------------------------------------------------------------------------------

    def advance(self, until_ns: int = NEVER_NS, until_rank: int = 0) -> int:
        """Process the samples in the streams that come before (``until_ns``, ``until_rank``).

        Returns
        -------
        int
            DONE, or FULL when the rows of output are.

        Raises
        ------
        FilterDivergence
            When a covariance is not positive definite or the state not finite.
        """
        log, streams, rows = self.log, self.streams, self.rows
        # A whole run has others than a live one.
        others = log, streams, rows
        code = self._run.call(others, *self.parts, streams, until_ns, until_rank, rows)
        self.check(code)
        return int(code)

    @staticmethod
    def check(code: int) -> None:
        """Raise FilterDivergence for the code of a failed update or step."""
        if code in _WHY:
            raise FilterDivergence(_WHY[code])

    def imu(self, sample: ImuSample) -> None:
        """Advance to the end of the sample's interval."""
        step, boundary_ns = self.history.step, int(self.state.counters[fs.BOUNDARY])
        st.put_imu(self.streams, sample)
        self.advance()
        if self.process is not None and self.history.step != step:
            Phi = self.past.transitions[self.history.step % len(self.past.transitions)]
            dt = (sample.stamp_ns - boundary_ns) * 1e-9
            self.process.add(self.state.P, Phi, self.work.q, dt)
            all_states = self.settings.estimates_usbl_bias or self.settings.heading.on
            active = kf.N if all_states else kf.USBL
            if not kf.cholesky(self.work.LP, self.state.P, active):
                raise FilterDivergence(_WHY[fs.P_NOT_DEFINITE])

    def dvl(self, ping: DvlPing) -> Outcome:
        """Fuse one valid DVL ping, with its stated or adapted noise; returns the outcome."""
        gated = self.state.tally[fs.DVL_ROW, fs.GATED]
        st.put_dvl(self.streams, ping)
        self.advance()
        return self.outcome(3, fused=bool(self.state.tally[fs.DVL_ROW, fs.GATED] == gated))

    def water_ping(self, ping: DvlPing) -> Outcome:
        """Fuse one velocity through the water; without degrees of freedom beside bottom lock."""
        counters, before_ns = self.state.counters, int(self.state.counters[fs.WATER_NS])
        st.put_dvl(self.streams, ping)
        self.advance()
        fused = bool(counters[fs.WATER_NS] != before_ns)
        m = 3 if fused or not self.has_bottom_lock else 0
        return self.outcome(m, fused=fused, joint=True)

    def reach(self, stamp_ns: int) -> None:
        """Advance to a stamp [ns] of a measurement that lies in a gap between IMU samples."""
        bridge.reach(
            self.state,
            self.frames,
            self.settings,
            self.past,
            self.work,
            self.log,
            stamp_ns,
        )

    @property
    def imu_stamp_ns(self) -> int:
        """Stamp of the newest IMU sample; `stamp_ns` may be later, in a gap."""
        return int(self.state.counters[fs.IMU_NS])

    def depth(self, sample: DepthSample) -> Outcome:
        """Fuse one depth; returns the outcome."""
        gated = self.state.tally[fs.DEPTH_ROW, fs.GATED]
        st.put_depth(self.streams, sample)
        self.advance()
        return self.outcome(1, fused=bool(self.state.tally[fs.DEPTH_ROW, fs.GATED] == gated))

    def heading(self, sample: HeadingSample) -> Outcome:
        """Fuse one heading if one is due; returns the outcome, of 0 values if none was used."""
        before = self.state.heading.copy()
        st.put_heading(self.streams, sample)
        self.advance()
        used, gated = (self.state.heading - before)[:2] > 0.0
        return self.outcome(1 if used or gated else 0, fused=bool(used))

    def control(self, sample: ControlSample) -> None:
        """Append a thrust for the vehicle's model."""
        st.put_control(self.streams, sample)
        self.advance()

    def model_estimate(self) -> ModelEstimate | None:
        """Estimated drag and current; None without a vehicle's model."""
        c = self.settings.aiding
        if not c.on:
            return None
        block = self.state.model.copy()
        block[fs.THRUST, fs.LOCKED] = self.has_bottom_lock
        return aiding.estimate_of(aiding.values_of(block[None], c)[0])

    @property
    def has_bottom_lock(self) -> bool:
        """Whether the last fused ping is recent; for a vehicle's model only."""
        age_ns = self.state.counters[fs.STAMP] - self.state.counters[fs.LOCK_NS]
        return bool(age_ns <= self.settings.aiding.lost_ns)

    @property
    def since_bottom_lock_s(self) -> float:
        """Time since the last fused ping [s]."""
        return float(self.state.counters[fs.STAMP] - self.state.counters[fs.LOCK_NS]) * 1e-9

    @property
    def has_water_track(self) -> bool:
        """Whether a recent velocity through the water was used; for a vehicle's model only."""
        age_ns = self.state.counters[fs.STAMP] - self.state.counters[fs.WATER_NS]
        return bool(age_ns <= self.settings.aiding.lost_ns)

    @property
    def knows_thrust(self) -> bool:
        """Whether the newest thrust is new enough for a vehicle's model."""
        counters = self.state.counters
        age_ns = counters[fs.STAMP] - counters[fs.THRUST_NS]
        return bool(counters[fs.THRUST_NS] > 0 and age_ns <= self.settings.aiding.thrust_ns)

    def fix_outcome(self, *, fused: bool) -> Outcome:
        """Outcome of the last update, which was one by a fix."""
        return self.outcome(fs.VECTOR, fused=fused, dof=int(self.work.dof[0]))

    def outcome(
        self, m: int, *, fused: bool, joint: bool = False, dof: int | None = None
    ) -> Outcome:
        """Outcome of the last update of m rows, read from the scratch.

        ``dof`` are its degrees of freedom, where these are not its rows.

        Its variances are what it was judged by, as in `kernels.sins.events.note_outcome`: with the
        common errors, but for a measurement that was fused jointly with the vehicle's model.
        """
        w = self.work
        variance, innovation = np.full(3, np.nan), np.full(3, np.nan)
        wide = self.considers and not joint
        variance[:m] = np.diagonal(w.wide)[:m] if wide else np.diagonal(w.S)[:m] / w.nis[1]
        innovation[:m] = w.z[:m]
        dof = m if dof is None else dof
        gate = float(self.settings.gates[dof])
        return Outcome(fused, innovation, variance, float(w.nis[0]), dof, gate, float(w.nis[1]))

    def outcome_of(self, row: Array) -> Outcome:
        """Outcome of a fix that the compiled loop decided, from its row of ``fix_outcomes``."""
        fused, nis, *values, enlargement, dof = row.tolist()
        z, variance = np.array(values[:3]), np.array(values[3:])
        gate = float(self.settings.gates[int(dof)])
        return Outcome(fused == fs.FUSED, z, variance, nis, int(dof), gate, enlargement)

    def taken_local_statistics(self) -> Array:
        """Counts (2, 3) of DVL and depth since the last call: used, gated, sum of NIS."""
        tally = self.state.tally
        taken: Array = tally[: fs.FIX_ROW].copy()
        tally[:] = 0.0
        return taken

    # -- rows that Python has filled --------------------------------------------------------------

    def fuse_fix(self) -> Outcome:
        """Gate the fix in ``H``, ``R``, ``z``, update and feed back; returns the outcome."""
        code = ff.fuse_filled(*self.parts, 3, fs.FIX_ROW, fs.FIX_RANK)
        self.check(code)
        return self.fix_outcome(fused=code == fs.FUSED)

    @property
    def published_P(self) -> Array:
        """Covariance with common errors and the conflict with refused fixes, (24, 24); a copy."""
        P: Array = self.state.P.copy()
        if self.considers:
            consider.add_common(P, self.state.sensitivity, self.settings.common, self.work.LP)
        consider.add_conflict(P, self.state.conflict)
        if self.settings.shares_leader or self.settings.heading.on:
            P[X.usbl_bias_a], P[:, X.usbl_bias_a] = 0.0, 0.0
        return P

    def snapshot_here(self) -> None:
        """Make the present the oldest state that can be gone back to."""
        self.log.counts[1] = 0
        fe.take_snapshot(self.state, self.log)

    def feed_back(self, x: Array) -> None:
        """Correct the state by an estimated error (24,), and store the correction."""
        ff.feed_back_and_remember(self.state, self.frames, self.settings, self.past, x)

    def replace_estimate(self, P: Array, change: Array) -> None:
        """Replace the covariance, and add ``change`` (24,), an error, to the estimate."""
        self.state.P[:] = P
        self.feed_back(-change)
