"""Fast replay of a bag from arrays: the numbers of `by_message.replay`, without messages.

`by_message.replay` is for the bytes (`verify`, `replay --out`); scores and reports only need
the estimates. Both drive the same engine in the same order of events.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from polar_nav_core import spilled
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.runaway import divergence_of
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.receipt_rows import Receipts
from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import inputs_of

from ..bags import Bag
from ..series.estimates import EstimateRows, receipts_of
from .arrays import SinsArrays, StationArrays
from .arrays_from_bag import load_arrays
from .by_message import parameters
from .recorded import choose_follower
from .result import LOOK_EVERY_S, ReplayedRun
from .station_run import replay_station

Progress = Callable[[float], None]


def replay_arrays(
    source: SinsArrays | StationArrays,
    *,
    configuration: str | None = None,
    changes: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> ReplayedRun:
    """Replayed run of a follower's recorded arrays; see `by_message.replay`."""
    params = parameters(source.params, configuration, changes or {})
    if isinstance(source, StationArrays):
        return replay_station(source, params)
    numbered = source.inputs(params)
    spilled.give_back_freed()
    rows = EstimateRows(params, _expected(numbered.inputs, params))
    result = engine_run.run(
        params,
        numbered.inputs,
        progress=progress,
        sink=rows.append,
        derived=True,
        look_every_s=LOOK_EVERY_S,
    )
    receipts: Sequence[Receipt] = result.receipts
    if source.refused or numbered.any_moved:
        found = map(numbered.renumbered, receipts)
        receipts = Receipts(_merged(found, source.refused))
        del found
    del numbered
    spilled.give_back_freed()
    verdicts = Counter(dict(result.verdicts))
    verdicts.update(r.verdict for r in source.refused)
    divergence = result.divergence or divergence_of(result.health)
    health = result.health
    del result
    spilled.give_back_freed()
    return ReplayedRun(
        vehicle=source.vehicle,
        params=params,
        taken=source.taken,
        estimates=rows.series(source.vehicle),
        receipts=receipts_of(receipts),
        verdicts={v.name: n for v, n in sorted(verdicts.items())},
        divergence=divergence,
        health=health,
    )


def _expected(inputs: Inputs, params: FollowerParams) -> int:
    """Approximate number of estimates."""
    stamps_ns = inputs.imu_stamps_ns
    length_s = 1e-9 * int(stamps_ns[-1] - stamps_ns[0]) if len(stamps_ns) else 0.0
    most = len(stamps_ns) + 1  # not more than samples, whatever the stamps are
    return min(int(length_s / params.output_period_s) + 2, most)


def replay_estimates(
    bag: Bag,
    configuration: str | None,
    vehicle: str | None,
    changes: Mapping[str, Any],
    progress: Progress,
) -> ReplayedRun | None:
    """Replayed run of a bag; None for a run that must be replayed by message."""
    # A parameter out of range is refused before a long bag is read.
    recorded = choose_follower(bag, vehicle)[1]
    chosen = parameters(recorded, configuration, changes)
    if inputs_of(chosen) != inputs_of(parameters(recorded, None, {})):
        return None  # the arrays are of what the recorded run took
    arrays = load_arrays(bag, vehicle, progress=_half(progress))
    if arrays is None:
        return None
    return replay_arrays(
        arrays,
        configuration=configuration,
        changes=changes,
        progress=lambda share: progress(0.5 + 0.5 * share),
    )


def _half(progress: Progress) -> Progress:
    return lambda share: progress(0.5 * share)


def _merged(found: Iterable[Receipt], refused: Sequence[Receipt]) -> Iterable[Receipt]:
    """Receipts in the order of publication: refusals after all receipts of their stamp."""
    waiting = list(reversed(refused))
    for receipt in found:
        while waiting and waiting[-1].stamp_ns < receipt.stamp_ns:
            yield waiting.pop()
        yield receipt
    yield from reversed(waiting)
