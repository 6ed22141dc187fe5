"""Input of a report for `write_report`: plain data, no file and no ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.grid import ecef_to_grid

from ..scoring import Balance, Comparison, compare
from ..scoring.compare import Run
from ..series.model import ModelRun
from ..series.vehicle import TruthSeries

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class StationRanges:
    """Readings and positions of a station, shapes (n, 3), (n,): station frame, SI."""

    station: Floats
    heading: Floats
    range: Floats
    bearing: Floats


@dataclass(frozen=True, eq=False)
class FixPositions:
    """Measured positions of the follower at the validity of its decoded fixes.

    Attributes
    ----------
    source : str
        Sender.
    sequence : ndarray of int64, shape (n,)
        As in the receipts.
    stamp_ns : ndarray of int64, shape (n,)
        Validity [ns].
    r_e : ndarray, shape (n, 3)
        Transponder, ECEF [m].
    """

    source: str
    sequence: Ints
    stamp_ns: Ints
    r_e: Floats

    @classmethod
    def from_ranges(
        cls,
        source: str,
        sequence: Ints,
        stamp_ns: Ints,
        ranges: StationRanges,
        station: TruthSeries,
        truth: TruthSeries,
    ) -> FixPositions:
        """Positions from range and bearing of a station, at the true height of that time.

        A slant range and a bearing leave the height open; the filter has it from the depth
        sensor. The station frame has its origin where the station was first, and its grid axes.
        """
        origin_e = station.r_e[0]
        C_e_s = ecef_to_grid(origin_e)
        rows = np.clip(np.searchsorted(truth.stamp_ns, stamp_ns), 0, len(truth) - 1)
        true_s = (truth.r_e[rows] - origin_e) @ C_e_s.T
        rise = true_s[:, 2] - ranges.station[:, 2]
        horizontal = np.sqrt(np.maximum(ranges.range**2 - rise**2, 0.0))
        angle = ranges.heading + ranges.bearing
        r_s = np.column_stack(
            [
                ranges.station[:, 0] + horizontal * np.cos(angle),
                ranges.station[:, 1] + horizontal * np.sin(angle),
                true_s[:, 2],
            ]
        )
        return cls(source, np.asarray(sequence), np.asarray(stamp_ns), origin_e + r_s @ C_e_s)

    @classmethod
    def from_broadcasts(
        cls, source: str, sequence: Ints, stamp_ns: Ints, leader_r_e: Floats, r_lf_G: Floats
    ) -> FixPositions:
        """Positions from a leader's own position and the relative vector in its grid axes.

        r_e = leader_r_e + C_G_e(leader) r_lf_G, shapes (n, 3).
        """
        C_e_G = ecef_to_grid(leader_r_e)
        r_e = leader_r_e + np.einsum('nji,nj->ni', C_e_G, r_lf_G)
        return cls(source, np.asarray(sequence), np.asarray(stamp_ns), r_e)


@dataclass(frozen=True, eq=False)
class SentPackets:
    """All packets sent to the follower (from acomms/tx), also the lost ones.

    Attributes
    ----------
    source : str
        Sender.
    sequence : ndarray of int64, shape (n,)
    transmit_ns : ndarray of int64, shape (n,)
    """

    source: str
    sequence: Ints
    transmit_ns: Ints


@dataclass(frozen=True)
class TopicCount:
    """Numbers of published, recorded and received messages of one topic; None if not counted."""

    topic: str
    published: int | None
    recorded: int | None
    received: int | None

    @property
    def equal(self) -> bool:
        """Whether all counts are equal."""
        known = {n for n in (self.published, self.recorded, self.received) if n is not None}
        return len(known) <= 1


@dataclass(frozen=True)
class Digest:
    """sha256 over the output of the live run and over that of its replay."""

    what: str  # topic or 'nav/state and nav/receipt'
    live: str  # hexadecimal
    replay: str

    @property
    def equal(self) -> bool:
        """Whether the replay repeated the live run bit for bit."""
        return bool(self.live) and self.live == self.replay


@dataclass(frozen=True, eq=False)
class ReportInput:
    """Input of one report.

    Attributes
    ----------
    title : str
        Heading, e.g. the bag's name.
    runs : mapping of str to (TruthSeries, EstimateSeries, sequence of ReceiptRecord)
        The follower's runs by configuration name, in the order of tables and colours; at least
        one. All of them are of one vehicle and one mission; put the one that ignores the delay
        first.
    subtitle : str
        The mission in a sentence.
    leader : TruthSeries or None
        The leader's truth, for the map.
    fixes : FixPositions or None
        For the map; without it fixes are shown at the true position of their validity.
    sent : SentPackets or None
        For packets that never arrived.
    counts : sequence of TopicCount
        Published, recorded, received per topic.
    balances : sequence of Balance
        received = sum of verdicts.
    digests : sequence of Digest
        Of `polar verify`.
    metadata : mapping of str to mapping
        Section -> name -> value: mission, seeds, versions, parameters. Shown as given.
    made : str
        When and by what, as text; nothing here reads a clock.
    comparison : Comparison or None
        Scores of `runs` when they are there already; computed otherwise.
    models : mapping of str to ModelRun
        Of the runs in which the vehicle's model took part; not needed with a `comparison`.
    judged : sequence of str
        Runs that decide whether all is well; the first of them leads the headline.
    """

    title: str
    runs: Mapping[str, Run]
    subtitle: str = ''
    leader: TruthSeries | None = None
    fixes: FixPositions | None = None
    sent: SentPackets | None = None
    counts: Sequence[TopicCount] = ()
    balances: Sequence[Balance] = ()
    digests: Sequence[Digest] = ()
    metadata: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    made: str = ''
    comparison: Comparison | None = None
    models: Mapping[str, ModelRun] = field(default_factory=dict)
    judged: Sequence[str] = ()

    def __post_init__(self) -> None:
        if not self.runs:
            raise ValueError(f'report {self.title!r}: runs is empty')
        if self.comparison is not None and list(self.comparison.scores) != list(self.runs):
            raise ValueError(
                f'report {self.title!r}: comparison is of {list(self.comparison.scores)}, '
                f'runs are {list(self.runs)}'
            )

    def scored(self) -> Comparison:
        """Scores of the runs."""
        if self.comparison is not None:
            return self.comparison
        return compare(self.runs, models=self.models)
