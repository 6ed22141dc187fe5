"""Identification beside the filter: its data, its triggers, and the adaptation of the filter.

The engine knows the protocol only. An identification runs inside the event that asks for it, so a
replay gives the same bytes; polar_nav_core.identification does the work.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import Array
from ...identification.result import Identification, IdentificationVerdict
from ..driver import Adaptation, Driver
from ..events import Fix
from ..params import EngineParams
from ..results import Outcome

PERIOD_NS = 100_000_000
"""Of the log of attitude and thrust."""


class StationAdaptation:
    """The identification of station mode.

    Parameters
    ----------
    params : EngineParams
    """

    def __init__(self, params: EngineParams) -> None:
        # scipy.optimize would cost every start of the other mode half a second.
        from ...identification.identifier import Identifier
        from ...identification.window import position_fix

        self._params = params
        self._identifier = Identifier(params)
        self._position_fix = position_fix
        self._last_ns: int | None = None
        self._accepted = False
        self._model_at: dict[int, Array] = {}

    def log(self, stamp_ns: int, C_b_G: Array, omega_b: Array, force_b: Array) -> None:
        """Store attitude, rate [rad/s] and thrust [N] at a stamp, at 10 Hz at most."""
        if self._last_ns is not None and stamp_ns < self._last_ns + PERIOD_NS:
            return
        self._last_ns = stamp_ns
        self._identifier.add_attitude(stamp_ns, C_b_G, omega_b)
        self._identifier.add_control(stamp_ns, force_b)

    def fix(self, fix: Fix, outcome: Outcome, driver: Driver) -> Identification | None:
        """Store a fix with its outcome at the gate; returns the identification if one was due."""
        if fix.polar is None:
            return None
        stated = self._params.noise_of(fix.polar)
        polar = replace(
            fix.polar,
            range_sigma=float(np.sqrt(stated[0])),
            bearing_sigma=float(np.sqrt(stated[1])),
            station_heading_sigma=stated[2],
        )
        position = self._position_fix(fix.validity_ns, polar, driver.height())
        self._identifier.add_fix(position, outcome.nis)
        self._model_at[fix.validity_ns] = np.array([position.x, position.y]) + outcome.z[:2]
        while len(self._model_at) > self._params.identify_fixes:
            del self._model_at[min(self._model_at)]
        trigger = self._identifier.due()
        return None if trigger is None else self.identify(fix.receive_ns, trigger, driver)

    def identify(self, stamp_ns: int, trigger: str, driver: Driver | None) -> Identification:
        """Identification from the data stored so far, triggered by the named cause.

        The track of the published method starts at the first fix at the first adaptation, later
        where the model was then (its text below Eq. 17).
        """
        start = None
        window = self._identifier.window()
        if self._accepted and window is not None:
            start = self._model_at.get(int(window.validity_ns[0]))
        result = self._identifier.identify(stamp_ns, trigger, start=start)
        if result.verdict is IdentificationVerdict.ACCEPTED and driver is not None:
            self._accepted = True
            if self._takes(trigger):
                driver.adapt(result)
        return result

    def _takes(self, trigger: str) -> bool:
        use = self._params.station_adaptation
        if use == 'auto':
            use = 'always' if self._params.station_filter == 'published' else 'command'
        return use == 'always' or (use == 'command' and trigger == 'command')


def make_adaptation(params: EngineParams) -> Adaptation | None:
    """Identification of station mode; None in SINS mode."""
    return StationAdaptation(params) if params.mode == 'station' else None
