"""Fixed-interval smoothing of a whole run: each estimate by all that was measured.

A filter processes the run with every fix at its validity, and its steps and updates are recorded
(`sins.tape`); the backward pass over them is compiled (`kernels.sins.smooth`). How late a fix came
does not matter here. What the gate decided is judged anew by the track that all others give
(`hindsight`), and the filter runs once more, linearized at that track, until nothing moves.
Equations: docs/derivations/smoother.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import overload

from .. import spilled
from ..arrays import Ints
from ..errors import ConfigError
from ..kernels.sins.consider import COLUMNS
from . import run as engine_run
from . import station_smoothing as of_station
from .backwards import Back, Move, backwards
from .events import Rank
from .hindsight import (
    Decisions,
    added_by_plan,
    added_by_weights,
    decide,
    plan_of,
    revisions_of,
)
from .inputs import Inputs, StationInputs
from .outputs import Receipt
from .params import EngineParams
from .receipt_rows import Receipts
from .sins.recorded import FixLog, Plan
from .sins.tape import Tape
from .sins.whole import usable_of
from .smoothed import MOST_PASSES, MOVED, Smoothed, at_validity, still_to_come
from .track import StationTrack, Track
from .verdicts import Verdict

LOOK_S = 60.0
"""How often the log is copied; the filter's rings hold more than twice that."""
_HISTORY_S = 130.0
_OUTPUT_S = 10.0
_TURN = 0.01
"""A correction that turns the attitude by less is linear to 1e-4 of the velocity [rad] (bend)."""
_TRACK_S = 1.0
"""From one state of the track that a filter is held to, to the next, at most."""


@overload
def smooth(
    params: EngineParams,
    inputs: Inputs,
    *,
    every_s: float = ...,
    covariances: bool = ...,
    passes: int = ...,
    at_least: int = ...,
    move: Move | None = ...,
    progress: Callable[[float], None] | None = ...,
) -> Smoothed[Track]: ...


@overload
def smooth(
    params: EngineParams,
    inputs: StationInputs,
    *,
    every_s: float = ...,
    passes: int = ...,
    progress: Callable[[float], None] | None = ...,
) -> Smoothed[StationTrack]: ...


def smooth(
    params: EngineParams,
    inputs: Inputs | StationInputs,
    *,
    every_s: float = 1.0,
    covariances: bool = False,
    passes: int = MOST_PASSES,
    at_least: int = 1,
    move: Move | None = None,
    progress: Callable[[float], None] | None = None,
) -> Smoothed[Track] | Smoothed[StationTrack]:
    """Smoothed track of a run of either mode, an estimate every so many seconds.

    Parameters
    ----------
    params : EngineParams
        Gate and weights are those of its configuration; how it treats late fixes does not count.
    inputs : Inputs or StationInputs
        Of station mode; of ``at_least``, ``covariances`` and ``move`` it knows nothing.
    every_s : float
        [s]; rounded to whole covariance steps, above a second to whole seconds.
    covariances : bool
        Whether the track keeps them, besides the columns derived from them.
    passes, at_least : int
        Most passes, and those that are made though nothing moves.
    move : callable, optional
        Moves the estimates of the track, with their covariances, to another point of the vehicle.
        It gets some at a time, the last ones first.
    progress : callable, optional

    Raises
    ------
    ConfigError
        For parameters that have no linear steps to go back over.
    """
    if isinstance(inputs, StationInputs):
        return of_station.smooth(params, inputs, every_s=every_s, passes=passes, progress=progress)
    with spilled.Spool() as record:
        run = _Passes(params, inputs, every_s, covariances, move, record)
        return run.run(passes, at_least, progress)


class _Passes:
    """Passes over one run, each with what the one before has shown.

    What their filters do goes to one record, or to one for each.
    """

    def __init__(
        self,
        params: EngineParams,
        inputs: Inputs,
        every_s: float,
        covariances: bool,
        move: Move | None = None,
        record: spilled.Spool | None = None,
    ) -> None:
        self._stated = in_order(params)
        fixes = (f for f in inputs.fixes if f.refusal is None and f.validity_ns > 0)
        self._inputs = replace(inputs, fixes=tuple(map(at_validity, fixes)))
        self._record = record
        self._usable = usable_of(self._stated, self._inputs)
        period_s = self._stated.filter_period_s
        self._every = max(1, round(min(every_s, _TRACK_S) / period_s))
        self._published = self._every * max(1, round(every_s / (self._every * period_s)))
        self._covariances, self._move = covariances, move

    def run(
        self, most: int, least: int, progress: Callable[[float], None] | None
    ) -> Smoothed[Track]:
        """Result of the last pass that changed something."""

        def part(number: int) -> Callable[[float], None] | None:
            if progress is None:
                return None
            return lambda share: progress((number + share) / most)

        first = found = self._pass(self._stated, None, part(0))
        stated = replace(self._stated, reopen_after_s=0.0)
        number, why = 1, found.why_again
        while (why or number < least) and not found.why_not and number < most:
            again = self._pass(stated, found.plan(self._inputs), part(number), found.moved)
            if again.why_not:
                found = replace(found, why_not=f'pass {number + 1}: {again.why_not}')
                break
            if found is first and not first.enlarged:  # never the result: its track may go
                first = replace(first, back=first.back.without_track())
            found, number = again, number + 1
            why = found.why_again
        if first.enlarged and found.fused < first.fused:
            # Not the start was in doubt, as of a filter that has too sure a one, but the model.
            found, number = first, 1
            why = 'the filter enlarged its covariance; without that fewer measurements fit'
        if progress is not None:
            progress(1.0)
        unsettled = '' if not why else found.why_not or why
        return _result(first, found, number, unsettled, self._stated.gate_probability)

    def _pass(
        self,
        params: EngineParams,
        plan: Plan | None,
        progress: Callable[[float], None] | None,
        before: float = math.inf,
    ) -> _Pass:
        log = FixLog()
        with Tape(self._every, log, plan, self._record) as tape:
            result = engine_run.run(
                params,
                self._inputs,
                sink=lambda _: tape.give_back(),
                derived=True,
                progress=progress,
                look_every_s=LOOK_S,
                tape=tape,
                usable=self._usable,
            )
            tape.give_back(freed=True)
            back = backwards(params, tape, self._published, self._covariances, self._move)
            tape.give_back(freed=True)
            why_not = ''
            if result.divergence or len(tape.parts) > 1:
                why_not = 'the filter was lost and began anew'
            elif params.model_aiding:
                why_not = 'a vehicle with model_aiding is smoothed in one pass'
            judged = back.judged
            if plan is None:
                added = added_by_weights(judged, log.enlargements)
            else:
                added = added_by_plan(judged, plan, log.fixes)
            configuration = params.resolved()
            return _Pass(
                back,
                log,
                decide(judged, configuration.gate_probability, configuration.robust_fixes, added),
                {Rank.DVL: tape.dvl_stamps_ns, Rank.DEPTH: tape.depth_stamps_ns},
                result.receipts,
                result.divergence,
                why_not,
                tape.enlarged,
                math.inf if plan is None else back.moved,
                before,
            )


@dataclass(frozen=True)
class _Pass:
    """Result of one pass, and what is decided by it."""

    back: Back
    fixes: FixLog
    decisions: Decisions
    stamps_ns: dict[Rank, Ints]
    receipts: Sequence[Receipt]
    divergence: str
    why_not: str
    """Why no filter can be held to this track."""
    enlarged: bool
    moved: float
    moved_before: float
    """Largest movement of the track in this pass and in the one before, of its sigma."""

    @property
    def fused(self) -> int:
        """Number of measurements that were fused."""
        return int(self.decisions.judged.fused.sum())

    @property
    def why_again(self) -> str:
        """Why another pass would give another track; empty where it would not."""
        if self.decisions.changed:
            return f'{self.decisions.changed} verdicts change with hindsight'
        if math.isinf(self.moved):
            if self.enlarged:
                return (
                    'the filter enlarged its covariance: what came before bears on nothing after'
                )
            if self._held_back:
                return f'{self._held_back} fixes were refused unseen'
            if self.decisions.reweighted:
                return f'{self.decisions.reweighted} fixes have another weight with hindsight'
            if self.back.largest_turn > _TURN:
                return f'the attitude is corrected by {self.back.largest_turn:.3f} rad'
        elif still_to_come(self.moved, self.moved_before) > MOVED:
            return f'the track moved by {self.moved:.2f} of its sigma'
        return ''

    @property
    def _held_back(self) -> int:
        """Fixes that were refused before the filter saw them: like a long row before them."""
        return sum(r.verdict is Verdict.GATED for r in self.receipts) - int(
            (~self.decisions.judged.fused & (self.decisions.judged.ranks == Rank.FIX)).sum()
        )

    def plan(self, inputs: Inputs) -> Plan:
        """Plan of the next pass."""
        return plan_of(
            self.decisions,
            self.fixes.fixes,
            (self.back.stamps_ns, self.back.states),
            len(inputs.dvl_stamps_ns),
            len(inputs.depth_stamps_ns),
        )


def _result(
    first: _Pass, last: _Pass, passes: int, unsettled: str, gate_probability: float
) -> Smoothed[Track]:
    revisions, receipts = revisions_of(
        first.decisions.judged,
        last.decisions,
        (first.fixes.fixes, last.fixes.fixes),
        last.stamps_ns,
        gate_probability,
        first.receipts,
    )
    common = last.back.common
    return Smoothed(
        track=last.back.track,
        receipts=Receipts(chain(first.receipts, receipts)),
        divergence=last.divergence,
        information=common[:, :COLUMNS].copy(),
        vector=common[:, COLUMNS].copy(),
        largest_turn=last.back.largest_turn,
        passes=passes,
        moved=last.moved,
        revisions=tuple(sorted(revisions, key=lambda r: (r.stamp_ns, r.topic, r.number))),
        unsettled=unsettled,
    )


def in_order(params: EngineParams) -> EngineParams:
    """The same filter for fixes that come when they are valid."""
    configuration = params.resolved()
    if params.mode != 'sins':
        raise ConfigError(
            'mode station: these are inputs of mode sins; recordings of a follower in station '
            'mode have a smoother of their own'
        )
    if configuration.noise_adaptation != 'none':
        raise ConfigError(
            f'noise_adaptation {configuration.noise_adaptation}: smoothing needs stated noise; '
            'use configuration default'
        )
    return replace(
        params,
        configuration='custom',
        delay_handling='ignore',
        noise_adaptation='none',
        gate_probability=configuration.gate_probability,
        robust_fixes=configuration.robust_fixes,
        history_s=_HISTORY_S,
        # Nobody reads what the filter puts out by itself.
        output_period_s=_OUTPUT_S,
        # The tape has no rows of a velocity through the water: such pings are left aside.
        water_track_sigma=0.0,
    )
