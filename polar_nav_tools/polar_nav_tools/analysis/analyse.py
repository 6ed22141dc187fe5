"""From a bag to figures: live estimates and replays, scored, counted, compared, drawn.

In: a bag, and the names of filter configurations to replay it with. Out: an :class:`Analysis`,
which the commands demo, score and report print, turn into JSON and draw.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polar_nav_ros.topics import IDENTIFICATION, MODEL, RECEIPT, RX, STATE, TX

from ..bags import Bag, BagError, open_bag
from ..bags.arrays import (
    estimates_from_cdr,
    load_estimates,
    load_receipts,
    load_truth,
    receipts_from_cdr,
)
from ..bags.model import load_model_run, load_true_model, model_run_from_cdr
from ..live.run import OUTCOME_NAME, RUN_FOLDER
from ..report.input import Digest, TopicCount
from ..scoring import Balance, Column, Comparison, Table, balances, compare, mission_phases
from ..scoring.compare import Run
from ..scoring.delivery import Delivery
from ..series.model import ModelRun
from ..terminal.progress import opening_display
from .packets import delivery_of

if TYPE_CHECKING:
    from ..bags.ahead import Wants
    from ..bags.request import Request
    from ..replay.verification import VerifyResult

RECORDER = '/recorder_node'
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Analysis:
    """What a bag says.

    Attributes
    ----------
    bag : Bag
        Where it came from.
    vehicle : str
        The follower.
    runs : mapping of str to (TruthSeries, EstimateSeries, sequence of Receipt)
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

    def complaints(self) -> list[str]:
        """Sentences on everything that is not as it must be; empty when all is well."""
        out = [f'{self.bag.path}: {problem}' for problem in self.bag.problems]
        out += [f'{name} diverged: {why}' for name, why in self.divergence.items() if why]
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
    truth_from: Bag | None = None,
    say: Say = lambda _: None,
    progress: Callable[[float], None] | None = None,
) -> Analysis:
    """Score the runs of one follower of a bag.

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
    truth_from : Bag, optional
        Another bag with the truth.
    say : callable
        Told what is going on.
    progress : callable, optional
        Told the share of reading and replaying that is done.

    Raises
    ------
    BagError
        When the bag lacks what is needed.
    """
    name = vehicle or follower_of(bag)
    arrays = None
    if configurations and not verified:
        from ..replay.by_array import load

        step = 1.0 / (1 + len(configurations))
        with_truth, reading = truth_from is None, _part(progress, 0.0, step)
        arrays = load(bag, name, truth=with_truth, progress=reading)
    truth = arrays.truth if arrays is not None else None
    if truth is None:
        truth = load_truth(truth_from or bag, name)
    runs: dict[str, Run] = {}
    models: dict[str, ModelRun | None] = {}
    divergence: dict[str, str] = {}
    verification = None
    if live:
        estimates = load_estimates(bag, name)
        title = f'{estimates.configuration} (recorded)'
        runs[title] = (truth, estimates, load_receipts(bag, name))
        models[title] = load_model_run(bag, name)
    if arrays is not None:
        from ..replay.by_array import replay_arrays

        for number, configuration in enumerate(configurations, 1):
            say(f'replaying with {configuration}')
            part = _part(progress, number * step, step)
            fast = replay_arrays(arrays, configuration=configuration, progress=part)
            divergence[configuration] = fast.divergence
            runs[configuration] = (truth, fast.estimates, fast.receipts)
            if fast.model is not None:
                models[configuration] = replace(fast.model, truth=load_true_model(bag, name))
    elif configurations or verified:
        from ..replay.by_message import replay
        from ..replay.recorded import load_inputs
        from ..replay.verification import verify

        inputs = load_inputs(bag, name)
        replayed = None
        for configuration in configurations:
            say(f'replaying with {configuration}')
            result = replay(inputs, configuration=configuration)
            if configuration == inputs.params.get('configuration'):
                replayed = result
            divergence[configuration] = result.divergence
            runs[configuration] = (
                truth,
                estimates_from_cdr(result.of(STATE), name),
                receipts_from_cdr(result.of(RECEIPT)),
            )
            models[configuration] = model_run_from_cdr(
                result.of(MODEL), result.of(IDENTIFICATION), load_true_model(bag, name)
            )
        if verified:
            say('comparing a replay with what was published live')
            verification = verify(inputs, replayed=replayed)
    received = bag.topics.get(f'/{name}/{RX}')
    packets = {RX: received.count} if received is not None else {}
    return Analysis(
        bag=bag,
        vehicle=name,
        runs=runs,
        comparison=compare(
            runs,
            models={name: model for name, model in models.items() if model is not None},
            phases=mission_phases(truth),
        ),
        balances={n: balances(receipts, packets) for n, (_, _, receipts) in runs.items()},
        counts=topic_counts(bag, read_outcome(bag.path).get('counts', {})),
        verification=verification,
        divergence=divergence,
        delivery=delivery_of(bag, name),
    )


def _part(
    progress: Callable[[float], None] | None, start: float, share: float
) -> Callable[[float], None] | None:
    """Progress of one part of the work, told as that of the whole."""
    if progress is None:
        return None
    return lambda done: progress(start + share * done)


def follower_of(bag: Bag) -> str:
    """Vehicle of the one follower in a bag: who has estimates, or described itself on /run_info.

    A leader that navigates by itself has estimates, too; then the descriptions tell who follows.

    Raises
    ------
    BagError
        When there is none, or there are several.
    """
    found = {t.name.split('/')[1] for t in bag.topics.values() if t.count and _is_state(t.name)}
    if len(found) != 1:
        from ..replay.recorded import followers_of

        described = set(followers_of(bag))
        found = found & described or described or found
    if len(found) == 1:
        return found.pop()
    if not found:
        raise BagError(f'{bag.path} has no follower: no message on <vehicle>/{STATE}')
    names = ', '.join(sorted(found))
    raise BagError(f'{bag.path} has {len(found)} followers ({names}): name one with --vehicle')


def _is_state(topic: str) -> bool:
    return topic.count('/') == 3 and topic.endswith(f'/{STATE}')


def read_outcome(bag: Path) -> dict[str, Any]:
    """Read how a live run ended, from the folder of its bag; empty for bags of other origin."""
    path = bag / RUN_FOLDER / OUTCOME_NAME
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except ValueError as error:
        raise BagError(f'{path}: not JSON: {error}') from error
    return content if isinstance(content, dict) else {}


def topic_counts(bag: Bag, counted: Mapping[str, Any]) -> tuple[TopicCount, ...]:
    """Published, recorded and received messages of each topic.

    Parameters
    ----------
    bag : Bag
        Has the recorded ones.
    counted : mapping
        Node -> 'published' and 'taken' -> topic -> count, as the nodes said at their end. Topics
        that no node counted (diagnostics and the like, which are not part of the experiment) are
        left out.
    """
    published: dict[str, int] = {}
    taken: dict[str, list[int]] = {}
    for node, counts in counted.items():
        for topic, count in counts.get('published', {}).items():
            published[topic] = published.get(topic, 0) + int(count)
        if node != RECORDER:  # what it took stands in the bag
            for topic, count in counts.get('taken', {}).items():
                taken.setdefault(topic, []).append(int(count))
    rows = []
    for topic in sorted(published):
        recorded = bag.topics[topic].count if topic in bag.topics else None
        rows.append(
            TopicCount(
                topic, published[topic], recorded, _worst(taken.get(topic), published[topic])
            )
        )
    return tuple(rows)


def _worst(counts: Sequence[int] | None, expected: int) -> int | None:
    """Count of the subscriber that is furthest from what was published."""
    return max(counts, key=lambda n: abs(n - expected)) if counts else None


def topic_table(counts: Sequence[TopicCount]) -> Table:
    """Show published, recorded and received side by side."""
    columns = (
        Column('topic', 'topic'),
        Column('published', 'published'),
        Column('recorded', 'recorded'),
        Column('received', 'received', doc='by the subscriber that is furthest off'),
        Column('equal', 'equal'),
    )
    rows = tuple(
        {
            'topic': c.topic,
            'published': c.published,
            'recorded': c.recorded,
            'received': c.received,
            'equal': c.equal,
        }
        for c in counts
    )
    return Table('Messages', columns, rows)


def wanted_of(vehicle: str | None, *, truth: bool) -> Wants:
    """What `analyse` reads of a bag when it replays: for `open_for`, which reads it on its way."""

    def wants(bag: Bag) -> Request | None:
        from ..replay.by_array import wanted

        return wanted(bag, vehicle or follower_of(bag), truth=truth)

    return wants


def open_for(path: Path, say: Say, ahead: Wants | None = None) -> Bag:
    """Open a bag and tell what is wrong with it, before anything is made of it."""
    with opening_display(path) as progress:
        bag = open_bag(path, progress, ahead=ahead)
    for problem in bag.problems:
        say(f'{path}: {problem}')
    return bag
