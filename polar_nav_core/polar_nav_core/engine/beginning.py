"""Where a filter begins: a stated state, or a saved one and the first seconds after a restart.

And what is kept of that: the heading that was stated, and what it contradicts (`replaced`).
"""

from __future__ import annotations

import math
from dataclasses import replace

from ..arrays import Array
from .driver import Driver
from .events import DvlPing, ImuSample, InitialState
from .first_seconds import WATCHED_SINCE, FirstSeconds
from .lever import Arm
from .params import EngineParams
from .plausibility import initial_problem
from .replaced import SETTLED, Before, Replaced, before_start, is_stated
from .restart import saved_problem
from .saved import SavedState
from .sins.fusion import Fusion

_AT_REST = 0.2
"""A vehicle that is stated to be slower keeps its attitude in a gap [m/s]."""
_MOST_TILT, _MOST_HEADING = 0.2, 0.5
"""That attitude may be off after a gap [rad], as in `kernels.sins.bridge`."""


class Beginning:
    """Where the filter of one vehicle begins, and from when on it can.

    Parameters
    ----------
    params : EngineParams
    arm : Arm or None
        From base_link, of which a stated state is, to the IMU.

    Attributes
    ----------
    state : InitialState or None
        As stated or saved; None until there is one.
    stated_heading : float
        1-sigma of the heading of the last stated one [rad]: a saved one has been learnt.
    replaced : Replaced or None
        What a stated one contradicts the navigation by that it replaced.
    """

    def __init__(self, params: EngineParams, arm: Arm | None) -> None:
        self._params, self._arm = params, arm
        self.state: InitialState | None = params.initial_state()
        self.stated_heading = 0.0 if self.state is None else self.state.sigma_heading
        self.replaced: Replaced | None = None
        self._first_seconds: FirstSeconds | None = None
        self._stated_ns: int | None = None
        self._before: Before | None = None

    def at(self, sample: ImuSample) -> tuple[InitialState, DvlPing | None] | None:
        """State that a filter begins from at a sample, with the ping since; None: it waits."""
        first = self._first_seconds
        if self.state is None or (first and not first.imu(sample)):
            return None
        if not isinstance(self.state, SavedState):
            return self._after_gap(self._at_imu(self.state), sample.stamp_ns), None
        if first is None:
            return self.state, None
        self._first_seconds = None
        return replace(self.state, seen=first.seen(sample.stamp_ns)), first.fresh

    def _at_imu(self, state: InitialState) -> InitialState:
        if isinstance(state, SavedState) or self._arm is None:
            return state
        return self._arm.to_imu(state)

    def _after_gap(self, state: InitialState, stamp_ns: int) -> InitialState:
        """State that was stated within a gap of the IMU, as what is known of it at its end.

        Its stamp is that of the last sample, and the moment that it is of lies anywhere between:
        so it is not moved on, but may be off by all that the vehicle did.
        """
        gap_s = 0.0 if self._stated_ns is None else (stamp_ns - self._stated_ns) * 1e-9
        if gap_s <= self._params.max_imu_gap_s:
            return state
        p, speed = self._params, math.hypot(*state.v_G)
        way = min(speed + state.sigma_velocity, p.max_speed) * gap_s
        wider = replace(
            state,
            sigma_position_horizontal=math.hypot(state.sigma_position_horizontal, way),
            sigma_position_vertical=math.hypot(state.sigma_position_vertical, way),
        )
        if speed < _AT_REST:
            return wider
        grown = min(gap_s, math.sqrt(gap_s))  # as in a gap that is bridged
        turn = math.radians(p.gap_attitude_sigma_deg) * grown
        faster = min(p.gap_velocity_sigma * grown, p.max_speed)
        return replace(
            wider,
            sigma_velocity=math.hypot(state.sigma_velocity, faster),
            sigma_tilt=math.hypot(state.sigma_tilt, min(turn, _MOST_TILT)),
            sigma_heading=math.hypot(state.sigma_heading, min(turn, _MOST_HEADING)),
        )

    def ping(self, ping: DvlPing) -> None:
        """Take a ping of the bottom, which shows how the vehicle moves after a restart."""
        if self._first_seconds is not None:
            self._first_seconds.ping(ping)

    def problem(self, state: InitialState | None) -> str:
        """Sentence about a state that no filter can begin from; empty if one can."""
        if state is None:
            return ''
        if isinstance(state, SavedState):
            return saved_problem(self._params, state)
        return initial_problem(state)

    def heading_sigma(self, stamp_ns: int) -> float:
        """1-sigma of the heading at the start [rad], with what it is known to contradict."""
        if self.replaced is None:
            return self.stated_heading
        return math.hypot(self.stated_heading, self.replaced.heading_doubt(stamp_ns))

    def watched(self, now: Driver | None, fused: int) -> Array | None:
        """Position (3,), ECEF [m], while the navigation before a stated start is evidence."""
        if self._before is None or not isinstance(now, Fusion):
            return None
        if self.replaced is not None or fused >= SETTLED:
            self._before = None  # said already, or settled
            return None
        return now.filter.state.r_e.copy()

    def watch(self, now: Driver | None, at_e: Array | None) -> None:
        """Compare what a fix has made of a start, from `watched`, with the navigation before."""
        if at_e is not None and self._before is not None and isinstance(now, Fusion):
            self.replaced = self._before.led_away(now, now.filter.state.r_e - at_e)

    def reset(
        self, state: InitialState | None, stamp_ns: int, old: Driver | None, fused: int
    ) -> None:
        """Begin anew from a state, or for None from that of the parameters.

        Parameters
        ----------
        state : InitialState or None
        stamp_ns : int
            When it was stated [ns].
        old : Driver or None
            The navigation that it replaces.
        fused : int
            Fixes that this one has used since its own start.
        """
        stated = None if self.state is None else self._at_imu(self.state)
        self.state = state or self._params.initial_state()
        self._stated_ns = stamp_ns
        start = None if self.state is None else self._at_imu(self.state)
        # One that agrees with a start that is contradicted itself settles nothing.
        settled = fused >= SETTLED
        contradiction = None if settled else self.replaced
        if self._before is None or settled or not is_stated(start):
            self._before = before_start(old, start, stamp_ns, self._params.max_imu_gap_s)
        elif start is not None:
            self._before.stated_again(old, stated, start, stamp_ns)
        if self._before is not None and start is not None:
            contradiction = self._before.contradicted(start) or contradiction
        self.replaced = contradiction
        self._first_seconds = None
        if isinstance(self.state, SavedState):
            if self._params.mode != 'station' and self.state.version >= WATCHED_SINCE:
                self._first_seconds = FirstSeconds(self._params, self.state)
        elif self.state is not None:
            self.stated_heading = self.state.sigma_heading
