"""Verdicts of measurements: counts, their balance with messages, NIS by source."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.engine.outputs import LOCAL_DOF, NIS_SUM, UPDATES
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.spilled import by_rows

from ..series.estimates import Records
from ..series.vehicle import KEY, Floats, Ints, ReceiptRecord, Series, last_places
from .consistency import Consistency, consistency, consistency_of_sums
from .json_values import record

FUSED = Verdict.FUSED.name
GATED = Verdict.GATED.name
# In the order of FixReceipt.msg, so that tables of different bags have the same order.
VERDICTS = tuple(verdict.name for verdict in Verdict)

UNKNOWN_NS = int(np.iinfo(np.int64).min)
"""A time that is not known, in a column of times: before every window."""

_ROW = np.dtype(
    [
        *((name, np.int64) for name in ('stamp_ns', 'validity_ns', 'receive_ns')),
        # Objects: in an array of str, one long text would make all rows as long.
        *((name, np.object_) for name in ('verdict', 'source', 'topic')),
        ('nis', np.float64),
        ('degrees_of_freedom', np.int64),
    ]
)


@dataclass(frozen=True, eq=False)
class VerdictSeries(Series):
    """Final verdict of each message (last revision), in the order of first receipts.

    Attributes
    ----------
    stamp_ns : ndarray of int64, shape (n,)
        When it was decided [ns].
    verdict, source, topic : ndarray of str, shape (n,)
        `ReceiptRecord.verdict_text`, who sent the message, and where it came.
    validity_ns, receive_ns : ndarray of int64, shape (n,)
        [ns]; UNKNOWN_NS where a receipt has None.
    nis, degrees_of_freedom : ndarray, shape (n,)
        NaN and 0 where not computed.
    revised : int
        Receipts that a later revision replaced.
    """

    stamp_ns: Ints
    verdict: NDArray[np.object_]
    source: NDArray[np.object_]
    topic: NDArray[np.object_]
    validity_ns: Ints
    receive_ns: Ints
    nis: Floats
    degrees_of_freedom: Ints
    revised: int = 0

    @classmethod
    def of(cls, receipts: Sequence[ReceiptRecord]) -> Self:
        """Series of the last revisions of `receipts`."""
        if isinstance(receipts, Records):
            return cls._of_columns(receipts)
        every, keyed = np.zeros(len(receipts), _ROW), []
        for k, r in enumerate(receipts):  # once: they are made when they are read
            times = (r.stamp_ns, _time(r.validity_ns), _time(r.receive_ns))
            words = (r.verdict_text, r.source, r.topic)
            every[k] = (*times, *words, r.nis, r.degrees_of_freedom)
            keyed.append((r.key, r.revision))
        rows = every[np.asarray(last_places(keyed), dtype=np.int64)]
        columns = {name: rows[name].copy() for name in _ROW.names or ()}
        return cls(**columns, revised=len(every) - len(rows))

    @classmethod
    def _of_columns(cls, records: Records) -> Self:
        """Series of a run of any length, without an object for each receipt."""
        times, texts = ('validity_ns', 'receive_ns'), ('source', 'topic')
        every = records.columns('stamp_ns', *times, 'verdict', *texts, 'nis', 'dof')
        every['degrees_of_freedom'] = every.pop('dof')
        for name in times:
            every[name][every[name] == 0] = UNKNOWN_NS
        every['verdict'] = np.array(VERDICTS, dtype=np.object_)[every['verdict']]
        rows, revisions = every, records.columns('revision')['revision']
        if revisions.any():  # hardly ever
            keys = zip(*(c.tolist() for c in records.columns(*KEY).values()), strict=True)
            places = last_places(list(zip(keys, revisions.tolist(), strict=True)))
            last = np.asarray(places, dtype=np.int64)
            rows = {name: column[last] for name, column in every.items()}
        return cls(**rows, revised=len(revisions) - len(rows['nis']))

    def fused(self) -> Self:
        """Rows of fused fixes with known validity and reception."""
        known = (self.validity_ns != UNKNOWN_NS) & (self.receive_ns != UNKNOWN_NS)
        return self.rows(known & (self.verdict == FUSED))


@dataclass(frozen=True)
class VerdictCounts:
    """Numbers of messages by final verdict."""

    total: int
    by_verdict: dict[str, int]  # only those that occur, in the order of FixReceipt.msg
    by_topic: dict[str, dict[str, int]] = field(default_factory=dict)
    revised: int = 0  # receipts that a later revision replaced

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return record(asdict(self))


@dataclass(frozen=True)
class Balance:
    """Balance of one topic: received messages = sum of verdicts."""

    topic: str
    received: int  # messages in the bag
    verdicts: int  # last revisions of receipts

    @property
    def balanced(self) -> bool:
        """Whether every received message has a verdict."""
        return self.received == self.verdicts

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return {**asdict(self), 'balanced': self.balanced}


def count_verdicts(series: VerdictSeries) -> VerdictCounts:
    """Numbers of messages by final verdict."""
    counts: dict[str, Counter[str]] = {}
    pairs = zip(series.topic, series.verdict, strict=True)
    for (topic, verdict), number in Counter(pairs).items():
        counts.setdefault(topic, Counter())[verdict] = number
    return VerdictCounts(
        total=len(series),
        by_verdict=_ordered(sum(counts.values(), Counter())),
        by_topic={topic: _ordered(counts[topic]) for topic in sorted(counts)},
        revised=series.revised,
    )


def balances(counts: VerdictCounts, received: Mapping[str, int]) -> tuple[Balance, ...]:
    """Balance of verdicts with messages, topic by topic.

    Parameters
    ----------
    counts : VerdictCounts
        Of one run.
    received : mapping of str to int
        Messages that the bag holds on each topic whose every message gets a receipt (acomms/rx); a
        leading slash does not matter. Local sensors get receipts only when refused and do not
        belong here.
    """
    verdicts: dict[str, int] = {}
    for name, by_verdict in counts.by_topic.items():
        topic = name.strip('/')
        verdicts[topic] = verdicts.get(topic, 0) + sum(by_verdict.values())
    return tuple(
        Balance(topic, int(count), verdicts.get(topic.strip('/'), 0))
        for topic, count in received.items()
    )


def nis_by_source(
    series: VerdictSeries, verdicts: Collection[str] = (FUSED, GATED)
) -> dict[str, Consistency]:
    """NIS of each sender's fixes, by default fused and gated together.

    Leaving out the gated ones cuts the tail off the distribution and flatters a filter that
    refuses what does not suit it; taking them in lets one wild fix rule the mean. Look at both.
    """
    judged = series.rows(
        np.isin(series.verdict, list(verdicts))
        & (series.degrees_of_freedom > 0)
        & np.isfinite(series.nis)
    )
    found = {}
    for source in sorted(set(judged.source)):
        own = judged.rows(judged.source == source)
        found[source] = consistency(own.nis, own.degrees_of_freedom)
    return found


def nis_of_local(statistics: NDArray[np.float64]) -> dict[str, Consistency]:
    """NIS of the DVL and depth measurements that were used, by source; sources with none too.

    Parameters
    ----------
    statistics : ndarray, shape (n, 2, 3)
        As in `EstimateSeries.local_statistics`.
    """

    def column(row: int, which: int) -> Floats:
        return by_rows(lambda some: some[:, row, which].copy(), statistics)

    return {
        source: consistency_of_sums(column(row, NIS_SUM), column(row, UPDATES), LOCAL_DOF[source])
        for row, source in enumerate(LOCAL_DOF)
    }


def in_order(verdicts: Iterable[str]) -> list[str]:
    """Distinct verdicts in the order of FixReceipt.msg, unknown ones last."""
    distinct = set(verdicts)
    return [v for v in VERDICTS if v in distinct] + sorted(distinct - set(VERDICTS))


def _ordered(counts: Mapping[str, int]) -> dict[str, int]:
    return {name: counts[name] for name in in_order(counts)}


def _time(time_ns: int | None) -> int:
    return UNKNOWN_NS if time_ns is None else time_ns
