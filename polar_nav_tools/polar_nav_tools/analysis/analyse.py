"""Analysis of a bag: live estimates and replays, scored, counted and compared.

In: a bag, and the names of filter configurations to replay it with. Out: an :class:`Analysis`,
which the commands demo, score and report print, turn into JSON and draw.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from polar_nav_core.engine.health.span import Span, span_of_health
from polar_nav_ros.topics import RESTORE, RX, TX

from ..bags import Bag
from ..bags.arrays import load_truth
from ..bags.model import load_true_model
from ..bags.run_folder import read_outcome
from ..replay.runs import load_replays, recorded
from ..report.input import Digest, TopicCount
from ..scoring import Balance, Comparison, balances, compare, mission_phases
from ..scoring.compare import Run
from ..scoring.delivery import Delivery
from ..series.run import SMOOTHER, RunSeries
from .counts import topic_counts
from .judged import LIVE, judged_of, live_span
from .opening import Say, follower_of
from .packets import delivery_of

if TYPE_CHECKING:
    from ..replay.verification import VerifyResult


@dataclass(frozen=True, eq=False)
class Analysis:
    """Result of an analysis: scores, verification, counts and series of a bag.

    Attributes
    ----------
    bag : Bag
        Where it came from.
    vehicle : str
        The follower.
    runs : mapping of str to (TruthSeries, EstimateSeries, sequence of ReceiptRecord)
        By the name shown: configurations replayed, or the live one.
    comparison : Comparison
        Their scores.
    balances : mapping of str to sequence of Balance
        Packets received against verdicts, for each run.
    counts : tuple of TopicCount
        Published, recorded and received, per topic.
    verification : VerifyResult or None
        Live against replay, where that was asked for.
    delivery : Delivery or None
        What became of the packets that were sent, where the bag has the sender's modem.
    spans : mapping of str to Span
        Levels of each run, and of the live one as `LIVE`.
    judged : tuple of str
        Runs that decide whether all is well; the others are judged in words only.
    """

    bag: Bag
    vehicle: str
    runs: Mapping[str, Run]
    comparison: Comparison
    balances: Mapping[str, Sequence[Balance]]
    counts: tuple[TopicCount, ...]
    verification: VerifyResult | None = None
    divergence: Mapping[str, str] = field(default_factory=dict)
    delivery: Delivery | None = None
    spans: Mapping[str, Span] = field(default_factory=dict)
    judged: tuple[str, ...] = ()

    def complaints(self) -> list[str]:
        """Sentences about all defects of the bag and the judged runs; empty if all is well."""
        out = [f'{self.bag.path}: {problem}' for problem in self.bag.problems]
        out += [text for name, text in self._not_well() if name in self.judged]
        for name, topics in self.balances.items():
            out += [
                f'{name}: {b.received} messages on {b.topic}, but {b.verdicts} verdicts'
                for b in topics
                if not b.balanced
            ]
        out += [
            f'{c.topic}: {c.published} published, {c.recorded} recorded, {c.received} received'
            for c in self.counts
            if not c.equal
        ]
        if self.delivery is not None and self.delivery.unsent:
            out.append(f'{self.delivery.unsent} packets were received, but {TX} has none of them')
        if self.verification is not None and not self.verification.equal:
            out.append(f'the replay differs from the live run: {self.verification.difference}')
        return out

    def remarks(self) -> list[str]:
        """Sentences about runs that stand beside the judged ones and were not well."""
        return [text for name, text in self._not_well() if name not in self.judged]

    def _not_well(self) -> list[tuple[str, str]]:
        """Runs that diverged, or whose watchdog ended or lasted in ERROR, with a sentence each."""
        out = [(n, f'{n} diverged: {why}') for n, why in self.divergence.items() if why]
        spans = self.spans.items()
        return [*out, *((n, f'{n}: {s.complaint}') for n, s in spans if s.complaint)]

    def digests(self) -> tuple[Digest, ...]:
        """Digests of live and replayed output, per topic."""
        v = self.verification
        if v is None:
            return ()
        return tuple(Digest(t, v.live_sha256[t], v.replay_sha256[t]) for t in v.live_sha256)


def analyse(
    bag: Bag,
    configurations: Sequence[str],
    *,
    vehicle: str | None = None,
    live: bool = False,
    verified: bool = False,
    smooth: bool = False,
    judge_live: bool = True,
    truth_from: Bag | None = None,
    say: Say = lambda _: None,
    progress: Callable[[float], None] | None = None,
) -> Analysis:
    """Analysis of the runs of one follower of a bag.

    Parameters
    ----------
    bag : Bag
        With the follower's inputs when there are configurations to replay.
    configurations : sequence of str
        Each replayed with the bag's own parameters otherwise.
    vehicle : str, optional
        Which follower, when there are several.
    live : bool
        Score the recorded estimates too.
    verified : bool
        Also compare live with replay, bit for bit.
    smooth : bool
        Score the smoother too, as `SMOOTHER`: beside the judged runs.
    judge_live : bool
        Let the run that went live decide, too, whether all is well.
    truth_from : Bag, optional
        Another bag with the truth.
    say : callable
        Called with a sentence on the work that begins.
    progress : callable, optional
        Called with the share of reading and replaying that is done.

    Raises
    ------
    BagError
        When the bag lacks what is needed.
    """
    name = vehicle or follower_of(bag)
    count = 1 + len(configurations) + smooth
    parts = [_part(progress, k / count, 1.0 / count) for k in range(count)]
    replays = None
    if configurations or verified:
        replays = load_replays(
            bag, name, by_message=verified, truth=truth_from is None, progress=parts[0]
        )
    truth = replays.truth if replays is not None else None
    if truth is None:
        truth = load_truth(truth_from or bag, name)
    series: dict[str, RunSeries] = {}
    if live:
        run = recorded(bag, name)
        series[f'{run.estimates.configuration} (recorded)'] = run
    verification = None
    if replays is not None:
        for title, run in replays.replayed(
            configurations, say, parts[1 : 1 + len(configurations)]
        ).items():
            model = run.model
            if model is not None:
                model = replace(model, truth=load_true_model(bag, name))
            series[title] = replace(run, model=model)
        verification = replays.verified(say) if verified else None
    if smooth:
        from ..smoothing.bag import smoothed_series

        series[SMOOTHER] = smoothed_series(bag, name, parts[-1])
    runs = {title: (truth, run.estimates, run.receipts) for title, run in series.items()}
    packets = _packets_of(bag, name)
    comparison = compare(
        runs,
        models={t: run.model for t, run in series.items() if run.model is not None},
        phases=mission_phases(truth),
    )
    return Analysis(
        bag=bag,
        vehicle=name,
        runs=runs,
        comparison=comparison,
        balances={
            n: balances(one.verdicts, packets)
            for n, one in comparison.scores.items()
            if n != SMOOTHER  # it leaves aside what holds no fix
        },
        counts=topic_counts(bag, read_outcome(bag.path).get('counts', {})),
        verification=verification,
        divergence={title: run.divergence for title, run in series.items()},
        delivery=delivery_of(bag, name),
        spans={
            LIVE: live_span(bag, name),
            **{title: span_of_health(run.health) for title, run in series.items()},
        },
        judged=(*judged_of(configurations), *([LIVE] if judge_live else [])),
    )


def _packets_of(bag: Bag, vehicle: str) -> dict[str, int]:
    """Number of packets by topic that must have verdicts; empty where the follower was away."""
    restored = bag.topics.get(f'/{vehicle}/{RESTORE}')
    received = bag.topics.get(f'/{vehicle}/{RX}')
    if received is None or (restored is not None and restored.count):
        return {}
    return {RX: received.count}


def _part(
    progress: Callable[[float], None] | None, start: float, share: float
) -> Callable[[float], None] | None:
    """Progress callback of one part of the work, scaled to the whole."""
    if progress is None:
        return None
    return lambda done: progress(start + share * done)
