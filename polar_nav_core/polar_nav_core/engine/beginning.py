"""Where a filter begins: a stated state, or a saved one and the first seconds after a restart.

And what is kept of that: the heading that was stated, and what it contradicts (`replaced`).
"""

from __future__ import annotations

import math
from dataclasses import replace

from .driver import Driver
from .events import DvlPing, ImuSample, InitialState
from .first_seconds import WATCHED_SINCE, FirstSeconds
from .lever import Arm
from .params import EngineParams
from .plausibility import initial_problem
from .replaced import SETTLED, Replaced, replaced
from .restart import saved_problem
from .saved import SavedState


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

    def at(self, sample: ImuSample) -> tuple[InitialState, DvlPing | None] | None:
        """State that a filter begins from at a sample, with the ping since; None: it waits."""
        first = self._first_seconds
        if self.state is None or (first and not first.imu(sample)):
            return None
        if not isinstance(self.state, SavedState):
            return self._at_imu(self.state), None
        if first is None:
            return self.state, None
        self._first_seconds = None
        return replace(self.state, seen=first.seen(sample.stamp_ns)), first.fresh

    def _at_imu(self, state: InitialState) -> InitialState:
        if isinstance(state, SavedState) or self._arm is None:
            return state
        return self._arm.to_imu(state)

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
        self.state = state or self._params.initial_state()
        # One that agrees with a start that is contradicted itself settles nothing.
        before = None if fused >= SETTLED else self.replaced
        start = None if self.state is None else self._at_imu(self.state)
        self.replaced = replaced(old, start, stamp_ns, self._params.max_imu_gap_s) or before
        self._first_seconds = None
        if isinstance(self.state, SavedState):
            if self._params.mode != 'station' and self.state.version >= WATCHED_SINCE:
                self._first_seconds = FirstSeconds(self._params, self.state)
        elif self.state is not None:
            self.stated_heading = self.state.sigma_heading
