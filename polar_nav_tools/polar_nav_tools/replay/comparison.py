"""Comparison of a follower's live outputs with those of a replay, by their numbers.

Another engine may give other bits on purpose: estimates are compared in units of their sigma, and
verdicts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message

from polar_nav_msgs.msg import Identification as IdentificationMsg
from polar_nav_ros import topics

from ..bags.arrays import estimates_from_cdr, load_estimates, receipts_from_cdr
from ..bags.decode import is_installed
from ..bags.model import model_from_cdr
from ..series.closeness import LIMIT_SIGMA, LIMIT_TEXT, Closeness, closeness, model_closeness
from ..series.vehicle import EstimateSeries
from .by_message import ReplayResult
from .recorded import RecordedInputs
from .records import stamp_of

RUNNING = 'was already navigating'
"""Of a follower that ran before the recording began."""


@dataclass(frozen=True)
class Comparison:
    """Differences, in sigma, of a replay from a recording of another engine version or machine.

    Attributes
    ----------
    closeness : Closeness or None
        Largest difference of the estimates; None where they cannot be compared.
    impossible : str
        Why they cannot be compared; empty where they can.
    failures : tuple of str
        Differences that have no sigma: verdicts on fixes and on identifications, and their number.
    """

    closeness: Closeness | None
    impossible: str = ''
    failures: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether all differences are within LIMIT_SIGMA."""
        return self.closeness is not None and self.closeness.close and not self.failures

    def problems(self) -> list[str]:
        """One sentence for each difference beyond the limit."""
        if self.closeness is None:
            return [f'not comparable: {self.impossible}']
        out = list(self.failures)
        if not self.closeness.close:
            c = self.closeness
            out.insert(
                0,
                f'the replay is {c.sigmas:.3g} sigma off in {c.what} at '
                f'{c.stamp_ns * 1e-9:.3f} s; the limit is {LIMIT_TEXT}',
            )
        return out

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            'comparable': self.closeness is not None,
            'not_comparable_because': self.impossible or None,
            'largest_difference': None if self.closeness is None else self.closeness.to_dict(),
            'failures': list(self.failures),
            'limit_sigma': LIMIT_SIGMA,
        }


def replayed_as_live(
    inputs: RecordedInputs, replayed: ReplayResult
) -> tuple[dict[str, list[bytes]], dict[str, int]]:
    """Replayed messages by topic that the live node published, or would have, in all its lives.

    And how many the recorder had missed before it found a node that was started again.
    """
    again: dict[str, list[bytes]] = {topic: [] for topic in inputs.live}
    late = dict.fromkeys(inputs.live, 0)
    for topic, messages in again.items():
        for number, life in enumerate(inputs.lives):
            found, missed = life.matching(topic, replayed.of(topic, number))
            messages += found
            late[topic] += missed if number else 0
    return again, late


def compare(inputs: RecordedInputs, replayed: ReplayResult) -> Comparison:
    """Comparison of a replay with recorded estimates, vehicle model and verdicts by numbers.

    nav/current repeats what nav/model states; of an identification, the verdict counts.

    Raises
    ------
    BagError
        For recorded estimates that cannot be decoded.
    """
    name = inputs.vehicle
    recorded = _recorded_estimates(inputs)
    first_ns = first_imu_ns(inputs)
    if len(recorded) and recorded.stamp_ns[0] < first_ns:
        return Comparison(None, f'the follower {RUNNING}, and {first_sample(first_ns)}')
    live, (again, _) = inputs.live, replayed_as_live(inputs, replayed)
    found = [closeness(recorded, estimates_from_cdr(again[topics.STATE], name))]
    if live.get(topics.MODEL):
        models = (live[topics.MODEL], again[topics.MODEL])
        found.append(model_closeness(*map(model_from_cdr, models)))
    for one in found:
        if not one.fields:
            return Comparison(None, f'{one.what}, at {one.stamp_ns * 1e-9:.3f} s')
    return Comparison(
        max(found, key=lambda one: one.sigmas),
        failures=(
            *_other_verdicts(live[topics.RECEIPT], again[topics.RECEIPT]),
            *_other_identifications(
                live.get(topics.IDENTIFICATION, []), again.get(topics.IDENTIFICATION, [])
            ),
        ),
    )


def _recorded_estimates(inputs: RecordedInputs) -> EstimateSeries:
    """Recorded estimates, read by the definition in the bag."""
    if is_installed(inputs.bag.channel(f'/{inputs.vehicle}/{topics.STATE}')):
        return estimates_from_cdr(inputs.live[topics.STATE], inputs.vehicle)
    return load_estimates(inputs.bag, inputs.vehicle)


def _other_verdicts(live: list[bytes], replayed: list[bytes]) -> list[str]:
    a, b = receipts_from_cdr(live), receipts_from_cdr(replayed)
    if len(a) != len(b):
        return [f'{topics.RECEIPT}: {len(a)} recorded, {len(b)} replayed']
    for i, (one, other) in enumerate(zip(a, b, strict=True)):
        if (one.key, one.revision, one.verdict) != (other.key, other.revision, other.verdict):
            return [
                f'{topics.RECEIPT}, message {i}: fix {one.sequence} was {one.verdict_text}, '
                f'replayed fix {other.sequence} {other.verdict_text}'
            ]
    return []


def _other_identifications(live: list[bytes], replayed: list[bytes]) -> list[str]:
    a, b = ([deserialize_message(d, IdentificationMsg) for d in m] for m in (live, replayed))
    if len(a) != len(b):
        return [f'{topics.IDENTIFICATION}: {len(a)} recorded, {len(b)} replayed']
    for i, (one, other) in enumerate(zip(a, b, strict=True)):
        if (one.verdict, one.names, one.fixes) != (other.verdict, other.names, other.fixes):
            return [
                f'{topics.IDENTIFICATION}, message {i}: was {one.verdict_text} of {one.fixes} '
                f'fixes, replayed {other.verdict_text} of {other.fixes}'
            ]
    return []


def first_sample(first_ns: int) -> str:
    """Return when the first IMU sample in a bag was, in words."""
    return f'the first IMU sample in the bag is of {first_ns * 1e-9:.3f} s'


def first_imu_ns(inputs: RecordedInputs) -> int:
    """Return the stamp of the first IMU sample in a bag [ns]."""
    messages = inputs.lives[0].messages
    return next(stamp_of(message) for topic, message in messages if topic == inputs.imu)
