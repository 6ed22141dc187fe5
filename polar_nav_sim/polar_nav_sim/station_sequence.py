"""Sequence of a station's interrogations: times of its pings, and a check of their period.

Driven by the stamps of truth alone, as the USBL's Interrogator. A cycle is over when the packet is
complete at the vehicle: 3 D / c + N / v + T_sigma after its ping. A shorter period is refused, or
the next ping waits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import choice, param

from .poses import NotKept, NotYet, Poses
from .section import Spec
from .sensors.station import Station, StationCycle, StationErrors, StationReading, least_period_s
from .trajectory import NS


@dataclass(frozen=True)
class SequenceSpec(Spec):
    """Period of a station's pings, and bit rate of its packets."""

    period_s: float = param(2.5, 's', 0.1, 3600.0, 'Between interrogations')
    first_ping_s: float = param(0.0, 's', 0.0, 3600.0, 'First interrogation after the start')
    bit_rate: float = param(9600.0, 'bit/s', 1.0, 1e6, 'Of the packets, 192 bits each')
    when_short: str = choice(
        'refuse',
        ('refuse', 'queue'),
        'Where period_s is shorter than 3 D/c + N/v + T_sigma: stop, or ping when it is done',
    )


class StationSequence:
    """One station that interrogates one vehicle periodically.

    Parameters
    ----------
    station : Station
        The model.
    own, target : Poses
        Poses of station and vehicle.
    spec : SequenceSpec
        Period and bit rate.
    errors : StationErrors
        Of the station: its processing time and turn-around count.
    start_ns, from_ns : int
        Start of the mission; interrogations before ``from_ns`` are never made.
    """

    def __init__(
        self,
        station: Station,
        own: Poses,
        target: Poses,
        spec: SequenceSpec,
        errors: StationErrors,
        start_ns: int,
        from_ns: int,
    ) -> None:
        self._station = station
        self._own, self._target = own, target
        self._spec = spec
        self._spare_s = errors.processing_s + errors.turn_around_s
        self._period_ns = round(spec.period_s * NS)
        self._first_ns = start_ns + round(spec.first_ping_s * NS)
        self.sequence = max(0, -(-(from_ns - self._first_ns) // self._period_ns))
        """Number of the next interrogation."""
        self.lost = 0
        """Number of cycles without a reply."""
        self.queued = 0
        """Number of pings later than their period."""
        self._free_ns = from_ns
        self.needed_ns = self._ping_ns()
        """Nothing new before the poses reach this time."""

    def advance(self, now_ns: int) -> Iterator[StationReading]:
        """Readings completed until a time that both poses have reached.

        Raises
        ------
        ConfigError
            Where the period is too short and ``when_short`` says refuse.
        """
        while now_ns >= self.needed_ns:
            try:
                cycle = self._station.cycle(
                    self.sequence, self._ping_ns(), self._own, self._target
                )
            except NotYet as early:
                self.needed_ns = early.needed_ns
                return
            except NotKept:
                # The vehicle's truth began later than the own: omitted, as before from_ns.
                self._next()
                continue
            if cycle.t4_ns > now_ns:
                self.needed_ns = cycle.t4_ns
                return
            self._take(cycle)
            reading = self._station.read(cycle)
            if reading is None:
                self.lost += 1
            else:
                yield reading

    def _take(self, cycle: StationCycle) -> None:
        """Count a cycle and check that it fits its period."""
        s = self._spec
        range_m = (
            0.5
            * cycle.sound_speed
            * ((cycle.t2_ns - cycle.t1_ns + cycle.t4_ns - cycle.t3_ns) / NS)
        )
        least_s = least_period_s(range_m, cycle.sound_speed, s.bit_rate, self._spare_s)
        if least_s > s.period_s and s.when_short == 'refuse':
            raise ConfigError(
                f'parameter period_s: {s.period_s} s is shorter than 3 D/c + N/v + T_sigma ='
                f' {least_s:.3f} s at the range of {range_m:.0f} m; raise it, or set when_short to'
                ' queue'
            )
        self._free_ns = cycle.t1_ns + round(least_s * NS)
        self._next()

    def _next(self) -> None:
        self.sequence += 1
        self.needed_ns = self._ping_ns()
        if self.needed_ns > self._due_ns():
            self.queued += 1

    def _due_ns(self) -> int:
        return self._first_ns + self.sequence * self._period_ns

    def _ping_ns(self) -> int:
        return max(self._due_ns(), self._free_ns)
