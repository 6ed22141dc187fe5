"""What became of every measurement: verdicts of fixes, whether they add up, NIS by source."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.engine.events import LOCAL_DOF, NIS_SUM, UPDATES

from ..series import Receipt, last_revisions
from .consistency import Consistency, consistency, consistency_of_sums
from .plain import record

FUSED = 'FUSED'
GATED = 'GATED'
# In the order of FixReceipt.msg, so that tables of different bags have the same order.
VERDICTS = (
    FUSED,
    GATED,
    'DUPLICATE',
    'TOO_OLD',
    'TOO_LATE',
    'FROM_FUTURE',
    'NOT_FINITE',
    'BAD_CRC',
    'BAD_MAC',
    'UNKNOWN_SOURCE',
    'IN_FLIGHT',
    'NOT_READY',
    'BAD_FORMAT',
)


@dataclass(frozen=True)
class VerdictCounts:
    """Last revisions only."""

    total: int
    by_verdict: dict[str, int]  # only those that occur, in the order of FixReceipt.msg
    by_topic: dict[str, dict[str, int]] = field(default_factory=dict)
    revised: int = 0  # receipts that a later revision replaced

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return record(asdict(self))


@dataclass(frozen=True)
class Balance:
    """received = sum of verdicts, for one topic."""

    topic: str
    received: int  # messages in the bag
    verdicts: int  # last revisions of receipts

    @property
    def balanced(self) -> bool:
        """Whether no message disappeared silently."""
        return self.received == self.verdicts

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return {**asdict(self), 'balanced': self.balanced}


def count_verdicts(receipts: Sequence[Receipt]) -> VerdictCounts:
    """Count what finally became of each message."""
    final = last_revisions(receipts)
    topics = sorted({r.topic for r in final})
    return VerdictCounts(
        total=len(final),
        by_verdict=_counted(r.verdict_text for r in final),
        by_topic={t: _counted(r.verdict_text for r in final if r.topic == t) for t in topics},
        revised=len(receipts) - len(final),
    )


def balances(receipts: Sequence[Receipt], received: Mapping[str, int]) -> tuple[Balance, ...]:
    """Compare verdicts with messages, topic by topic.

    Parameters
    ----------
    receipts : sequence of Receipt
        Of one run, all revisions.
    received : mapping of str to int
        Messages that the bag holds on each topic whose every message gets a receipt (acomms/rx); a
        leading slash does not matter. Local sensors get receipts only when refused and do not
        belong here.
    """
    final = last_revisions(receipts)
    verdicts: dict[str, int] = {}
    for receipt in final:
        topic = receipt.topic.strip('/')
        verdicts[topic] = verdicts.get(topic, 0) + 1
    return tuple(
        Balance(topic, int(count), verdicts.get(topic.strip('/'), 0))
        for topic, count in received.items()
    )


def nis_by_source(
    receipts: Sequence[Receipt], verdicts: Collection[str] = (FUSED, GATED)
) -> dict[str, Consistency]:
    """NIS of each sender's fixes, by default fused and gated together.

    Leaving out the gated ones cuts the tail off the distribution and flatters a filter that
    refuses what does not suit it; taking them in lets one wild fix rule the mean. Look at both.
    """
    judged = [
        r
        for r in last_revisions(receipts)
        if r.verdict_text in verdicts and r.degrees_of_freedom > 0 and np.isfinite(r.nis)
    ]
    return {
        source: consistency(
            [r.nis for r in judged if r.source == source],
            [r.degrees_of_freedom for r in judged if r.source == source],
            independent=True,
        )
        for source in sorted({r.source for r in judged})
    }


def nis_of_local(statistics: NDArray[np.float64]) -> dict[str, Consistency]:
    """NIS of the DVL and depth measurements that were used, by source; sources with none too.

    Parameters
    ----------
    statistics : ndarray, shape (n, 2, 3)
        As in `EstimateSeries.local_statistics`.
    """
    return {
        source: consistency_of_sums(
            statistics[:, row, NIS_SUM], statistics[:, row, UPDATES], LOCAL_DOF[source]
        )
        for row, source in enumerate(LOCAL_DOF)
    }


def in_order(verdicts: Iterable[str]) -> list[str]:
    """Distinct verdicts in the order of FixReceipt.msg, unknown ones last."""
    distinct = set(verdicts)
    return [v for v in VERDICTS if v in distinct] + sorted(distinct - set(VERDICTS))


def _counted(names: Iterable[str]) -> dict[str, int]:
    found: dict[str, int] = {}
    for name in names:
        found[name] = found.get(name, 0) + 1
    return {name: found[name] for name in in_order(found)}
