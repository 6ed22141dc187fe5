"""Health of a navigation in either mode: what the engine has found, judged by a watchdog."""

from __future__ import annotations

import math
from dataclasses import replace

from .beginning import Beginning
from .clock_record import ClockRecord
from .driver import Driver
from .health.conditions import Condition, Culprit, Health, Level
from .health.heading import UNKNOWN, LostHeading, heading_lost, heading_unknown
from .health.station import StationWatchdog
from .health.view import Envelope
from .health.watchdog import Watchdog, refused_alone
from .ledger import FixLedger
from .params import EngineParams
from .plausibility import LEAST_PING_VARIANCE
from .restored import Restored
from .sins.fusion import Fusion
from .sins.view import heading_measured_ns, view_of
from .station.fusion import StationFusion
from .station.view import view_of as station_view_of
from .switches import Switches
from .unused import ALARMING

_TOO_SURE_NS = 60_000_000_000


class HealthMonitor:
    """Watchdog of the mode, with what ledger, switches and clocks say beside it.

    Parameters
    ----------
    params : EngineParams
    ledger : FixLedger
    switches : Switches
    clock : ClockRecord
    """

    def __init__(
        self, params: EngineParams, ledger: FixLedger, switches: Switches, clock: ClockRecord
    ) -> None:
        watchdog = StationWatchdog if params.mode == 'station' else Watchdog
        self._watchdog = watchdog(
            Envelope(
                params.max_speed,
                params.max_depth,
                params.lost_radius,
                params.max_imu_gap_s,
                params.sensor_silent_s,
                params.max_current or math.inf,
            )
        )
        self._ledger, self._switches, self._clock = ledger, switches, clock
        self._dvl_sigma = params.dvl_sigma

    def look(
        self,
        fusion: Driver,
        restored: Restored,
        beginning: Beginning,
        resets: int,
        too_sure_ns: int | None = None,
    ) -> Health | None:
        """Health of the navigation at its newest sample; None for a filter that has no watchdog.

        Parameters
        ----------
        fusion : Driver
        restored : Restored
            Losses of the filter so far.
        beginning : Beginning
            How sure the stated heading was, and what it contradicts.
        resets : int
            Starts and enlargements so far, without those losses.
        too_sure_ns : int, optional
            When a ping last stated less noise than pings have [ns].
        """
        # Of the state's own stamp: a node looks after the next sample came, a whole run before.
        stamp_ns, ledger = fusion.stamp_ns, self._ledger
        agreement = ledger.integrity.state(stamp_ns)
        found = self._switches.conditions()
        resets += restored.count
        if isinstance(fusion, StationFusion):
            # A station stays where it is: what its fixes contradict may be the vehicle's model.
            either = Culprit.FIXES | Culprit.MODEL
            found = [*(replace(c, culprit=either) for c in agreement.conditions), *found]
            found += ledger.conditions(stamp_ns)
            found += self._clock.conditions(stamp_ns)
            found += restored.conditions(stamp_ns)
            return self._watchdog.look(station_view_of(fusion, stamp_ns, resets), found)
        if isinstance(fusion, Fusion):
            found += ledger.conditions(stamp_ns)
            found += restored.conditions(stamp_ns)
            found += ledger.integrity.moved
            if beginning.replaced is not None:
                found += beginning.replaced.conditions(stamp_ns, ledger.fused_since_start)
            found += self._clock.conditions(stamp_ns)
            found += self._pings_too_sure(stamp_ns, too_sure_ns)
            view = view_of(fusion, stamp_ns, resets)
            unknown = self._heading_unknown(fusion, beginning.stated_heading)
            found += unknown or self._heading_lost(fusion, view.stamp_ns)
            agreed = agreement.conditions
            if agreement.gated_run >= ALARMING:
                agreed = [refused_alone(condition, view) for condition in agreed]
            return self._watchdog.look(view, [*agreed, *found])
        return None

    def _heading_unknown(self, fusion: Fusion, at_start: float) -> list[Condition]:
        if at_start < UNKNOWN:
            return []
        return heading_unknown(at_start, _sigma_of(fusion), self._ledger.fused_since_start)

    def heading_to_save(self, fusion: Driver) -> tuple[int, bool] | None:
        """`SavedState.lost_heading`, by the IMU's own clock."""
        lost = self._ledger.lost_heading
        if lost is None or not isinstance(fusion, Fusion):
            return None
        return self._clock.own_ns(lost.anew_ns), _is_measured(fusion, lost)

    def _heading_lost(self, fusion: Fusion, stamp_ns: int) -> list[Condition]:
        """The condition that nothing has shown the heading since the navigation began anew."""
        lost = self._ledger.lost_heading
        if lost is None:
            return []
        since_s = (stamp_ns - lost.anew_ns) * 1e-9
        return heading_lost(_sigma_of(fusion), since_s, measured=_is_measured(fusion, lost))

    def _pings_too_sure(self, stamp_ns: int, too_sure_ns: int | None) -> list[Condition]:
        """The condition that pings stated less noise than pings have, in the minute before."""
        if too_sure_ns is None or stamp_ns > too_sure_ns + _TOO_SURE_NS:
            return []
        best = math.sqrt(LEAST_PING_VARIANCE)
        used = max(self._dvl_sigma, best)
        sentence = (
            f'the DVL states less noise than {1e3 * best:.0f} mm/s, which no DVL has: '
            f'{1e3 * used:.3g} mm/s are used'
        )
        return [Condition('dvl too sure', Level.WARN, Culprit.DVL, sentence)]


def _is_measured(fusion: Fusion, lost: LostHeading) -> bool:
    """Whether something has measured a heading since it was lost."""
    return heading_measured_ns(fusion.filter) > lost.shown_after_ns


def _sigma_of(fusion: Fusion) -> float:
    """Published 1-sigma of the heading [rad]."""
    return math.sqrt(fusion.filter.published_P[2, 2])
