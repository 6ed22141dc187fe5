"""Smoothing of a run in station mode: passes of the bank, held to the track of the pass before.

As engine.smoothing, for a bank of filters: each member is smoothed by itself, with its own walk of
the current, and the members are mixed by their weights given all fixes. Identifications are left
out: drag and current are estimated by the members' own states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from ..arrays import Array
from ..errors import ConfigError
from ..kernels.station import state as ss
from . import run as engine_run
from .events import Fix, OrderKey
from .hindsight import Decisions, decide_by_gate, revisions_of
from .inputs import StationInputs
from .outputs import Receipt
from .params import EngineParams
from .receipt_rows import Receipts
from .results import chi2_gate
from .smoothed import MOVED, Smoothed, at_validity, still_to_come
from .station.arrays import densities, make_settings
from .station.fixes import dated
from .station.recorded import FixPlan, Plan, Tape
from .station_backwards import Back, backwards
from .track import StationTrack

_NODE_S = 1.0
"""From one node to the next, at most."""
_OUTPUT_S = 10.0
_WORSE = 1.1
"""Factor on the mean square of the residuals beyond which a pass is given up."""


@dataclass(frozen=True)
class _Pass:
    """Result of one pass, and what is decided by it."""

    back: Back
    fixes: list[Fix]
    decisions: Decisions
    inflations: Array
    receipts: Sequence[Receipt]
    divergence: str
    moved: float
    moved_before: float
    """Largest movement of the track in this pass and in the one before, of its sigma."""

    ended: str = ''
    """Why the pass after this one is none."""

    def misfit(self, gate: float) -> float:
        """Mean square of the residuals of the fixes, an outlier counted as at the gate."""
        nis = self.decisions.nis[np.isfinite(self.decisions.nis)]
        return float(np.minimum(nis, gate).mean()) if len(nis) else 0.0

    @property
    def why_not(self) -> str:
        """Why no filter can be held to this track; empty where one can."""
        if self.ended:
            return self.ended
        if self.divergence or self.back.parts > 1:
            return 'the filter was lost and began anew'
        return ''

    @property
    def why_again(self) -> str:
        """Why another pass would give another track; empty where it would not."""
        if self.decisions.changed:
            return f'{self.decisions.changed} verdicts change with hindsight'
        if math.isinf(self.moved):
            return 'the filter is linearized at its own track'
        if still_to_come(self.moved, self.moved_before) > MOVED:
            return f'the track moved by {self.moved:.2f} of its sigma'
        return ''

    def plan(self) -> Plan:
        """Plan of the next pass."""
        planned: dict[OrderKey, FixPlan] = {}
        judged = self.decisions.judged
        outcomes = self._loosened() if math.isinf(self.moved) else self.back.outcomes.copy()
        for k, number in enumerate(judged.samples.tolist()):
            outcome = outcomes[k]
            outcome[ss.DECIDED] = ss.FUSED if self.decisions.fused[k] else ss.REFUSED
            outcome[ss.INFLATION] = self.inflations[k]
            planned[self.fixes[number].key] = FixPlan(outcome, float(self.inflations[k]))
        return Plan(self.back.states, planned)

    def _loosened(self) -> Array:
        """Rows of outcomes (n, OUTCOME), with the model loose from when it began to fail.

        A filter finds that some time after it began; with hindsight it is loosened then, with
        the unexplained way and the further walk of the current that were found.
        """
        out = self.back.outcomes.copy()
        stamps_ns = np.array(
            [self.fixes[n].validity_ns for n in self.decisions.judged.samples], dtype=np.int64
        )
        for k in np.flatnonzero(self.back.outcomes[:, ss.WAY] > 0.0).tolist():
            way, lasted_s = self.back.outcomes[k, ss.WAY], self.back.outcomes[k, ss.LASTED_S]
            since_ns = stamps_ns[k] - round(lasted_s * 1e9)
            first = max(0, int(np.searchsorted(stamps_ns, since_ns)) - 1)
            out[k, ss.WAY] = 0.0
            if way > out[first, ss.WAY]:
                out[first, ss.WAY], out[first, ss.LASTED_S] = way, lasted_s
            out[first:k, ss.FURTHER] = np.maximum(out[first:k, ss.FURTHER], out[k, ss.FURTHER])
        return out


def smooth(
    params: EngineParams,
    inputs: StationInputs,
    *,
    every_s: float,
    passes: int,
    progress: Callable[[float], None] | None = None,
) -> Smoothed[StationTrack]:
    """Smoothed track of a run of station mode, an estimate every so many seconds.

    Parameters
    ----------
    params : EngineParams
        Gate and weights are those of its configuration; how it treats late fixes does not count.
    inputs : StationInputs
    every_s : float
        [s]; above a second rounded to whole ones.
    passes : int
        Most passes.
    progress : callable, optional

    Raises
    ------
    ConfigError
        For the published filter, which takes drag and current as known.
    """
    stated = in_order(params)
    dated_fixes = (dated(params, f) for f in inputs.fixes if f.refusal is None)
    fixes = tuple(at_validity(f) for f in dated_fixes if f.validity_ns > 0)
    inputs = replace(inputs, fixes=fixes)
    every_ns = round(min(every_s, _NODE_S) * 1e9)
    shown_ns = every_ns * max(1, round(every_s * 1e9 / every_ns))

    def part(number: int) -> Callable[[float], None] | None:
        if progress is None:
            return None
        return lambda share: progress((number + share) / passes)

    gate = chi2_gate(stated.resolved().gate_probability, 2)
    first = found = _pass(stated, inputs, (every_ns, shown_ns), None, part(0))
    number, why = 1, found.why_again
    while why and not found.why_not and number < passes:
        nodes_ns, plan = (every_ns, shown_ns), found.plan()
        again = _pass(stated, inputs, nodes_ns, plan, part(number), found.moved)
        worse = again.why_not or _worse(again, found, gate)
        if worse:
            found = replace(found, ended=f'pass {number + 1}: {worse}')
            break
        found, number, why = again, number + 1, again.why_again
    if progress is not None:
        progress(1.0)
    revisions, receipts = revisions_of(
        first.decisions.judged,
        found.decisions,
        (first.fixes, found.fixes),
        {},
        stated.resolved().gate_probability,
        first.receipts,
    )
    return Smoothed(
        track=found.back.track,
        receipts=Receipts(chain(first.receipts, receipts)),
        divergence=found.divergence,
        information=np.zeros((0, 0)),
        vector=np.zeros(0),
        largest_turn=0.0,
        passes=number,
        moved=found.moved,
        revisions=tuple(sorted(revisions, key=lambda r: (r.stamp_ns, r.topic, r.number))),
        unsettled=(found.why_not or why) if why else '',
    )


def _worse(again: _Pass, before: _Pass, gate: float) -> str:
    """Why a pass is no better than the one before; empty where it is one."""
    was, now = before.misfit(gate), again.misfit(gate)
    if now > _WORSE * was:
        return f'fixes fit worse at its track (mean square {now:.2f} after {was:.2f})'
    return ''


def _pass(
    params: EngineParams,
    inputs: StationInputs,
    nodes_ns: tuple[int, int],
    plan: Plan | None,
    progress: Callable[[float], None] | None,
    moved_before: float = math.inf,
) -> _Pass:
    def part(start: float, size: float) -> Callable[[float], None] | None:
        if progress is None:
            return None
        return lambda share: progress(start + size * share)

    tape = Tape(len(densities(params)), *nodes_ns, plan)
    with tape.nodes:
        result = engine_run.run(
            params, inputs, sink=lambda _: None, progress=part(0.0, 0.7), tape=tape
        )
        back = backwards(tape, part(0.7, 0.3))
    configuration = params.resolved()
    decisions = decide_by_gate(back.judged, configuration.gate_probability)
    return _Pass(
        back,
        tape.fixes,
        decisions,
        _inflations(decisions, make_settings(params)),
        result.receipts,
        result.divergence,
        math.inf if plan is None else back.moved,
        moved_before,
    )


def _inflations(decisions: Decisions, settings: ss.Settings) -> Array:
    """By how much S of each fix (n,) is enlarged for how far off it is with hindsight.

    The weight goes by the covariance V of the residual to all others; S is larger by what the
    filter did not know yet, which is not at fault.
    """
    squared = decisions.nis / settings.robust_threshold
    factor = np.ones_like(squared)
    far = np.isfinite(squared) & (squared > 1.0)
    if settings.robust == ss.ROBUST_MAHALANOBIS:
        factor[far] = squared[far]
    elif settings.robust == ss.ROBUST_HUBER:
        factor[far] = np.sqrt(squared[far])
    judged = decisions.judged
    V = np.trace(judged.covariances[:, :2, :2], axis1=1, axis2=2)
    S = np.trace(judged.S[:, :2, :2], axis1=1, axis2=2)
    return np.asarray(1.0 + (factor - 1.0) * np.minimum(V / S, 1.0))


def in_order(params: EngineParams) -> EngineParams:
    """The same bank for fixes that come when they are valid."""
    if params.station_filter == 'published':
        raise ConfigError(
            'station_filter published: smoothing needs drag and current as states; use augmented'
        )
    configuration = params.resolved()
    return replace(
        params,
        configuration='custom',
        delay_handling='ignore',
        noise_adaptation='none',
        gate_probability=configuration.gate_probability,
        robust_fixes=configuration.robust_fixes,
        station_validity='packet',
        output_period_s=_OUTPUT_S,
    )
