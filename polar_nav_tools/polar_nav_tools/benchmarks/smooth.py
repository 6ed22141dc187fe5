"""`polar bench smooth`: a smoothing pass beside the filter, and beside GTSAM where it is there.

Means and sigmas of the same linear problem are compared with GTSAM's first. A recording is timed
by itself: what its filter decides about fixes on the way is no linear problem.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec

import numpy as np

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams

from ..scoring import Column, Table
from .factor_graph import AS_STATED, FactorGraph, linear_run
from .late_fixes import simulated
from .navigation import Disagreement
from .rounds import Entry, Timing, interleave, ratio

DISTRIBUTIONS = ('numpy', 'numba', 'gtsam')
DURATION_S = 600.0
PASS_GOAL, AGAIN_GOAL = 2.5, 1.5
"""Most time of a smoothing pass, and of a further one, over that of the filter."""
BOUND = 0.01
"""Largest difference of means [sigma], and of sigmas as a share."""
_FIX_PERIOD_S = 10.0
_DELAY_S = 5.0


@dataclass(frozen=True)
class SmoothBenchmark:
    """Times of one run.

    Attributes
    ----------
    rounds : int
    duration_s : float
    timings : mapping of str to Timing
        Of `filter`, `one`, `two` passes and, where it is installed, `gtsam`. Without `two` where
        a recording cannot have a second pass.
    agreement : float
        Largest difference from GTSAM [sigma]; NaN without it.
    path : str
        Of a recording.
    """

    rounds: int
    duration_s: float
    timings: Mapping[str, Timing]
    agreement: float = float('nan')
    path: str = ''

    @property
    def one_pass(self) -> float:
        """Time of the first pass over that of the filter."""
        return ratio(self.timings, 'one', 'filter').median

    @property
    def further(self) -> float | None:
        """Time of a further pass over that of the filter; None where there is none."""
        if 'two' not in self.timings:
            return None
        return ratio(self.timings, 'two', 'filter').median - self.one_pass

    @property
    def peer(self) -> float | None:
        """Time of GTSAM over that of the first pass; None without it."""
        return ratio(self.timings, 'gtsam', 'one').median if 'gtsam' in self.timings else None

    def goals(self) -> list[tuple[str, float, float]]:
        """Goals: what, at most, found."""
        found = [('first pass / filter', PASS_GOAL, self.one_pass)]
        if self.further is not None:
            found.append(('further pass / filter', AGAIN_GOAL, self.further))
        return found

    def tables(self) -> list[Table]:
        """Times, and goals."""
        times = [{'title': t.title, 'ms': 1e-3 * t.median_us} for t in self.timings.values()]
        goals: list[dict[str, object]] = [
            {'what': what, 'most': most, 'found': found, 'met': 'yes' if found <= most else 'NO'}
            for what, most, found in self.goals()
        ]
        if self.peer is not None:
            goals.append({'what': 'GTSAM / first pass', 'found': self.peer})
        return [
            Table(
                f'{self.path}, {self.duration_s:.0f} s'
                if self.path
                else f'A run of {self.duration_s:g} s',
                (Column('title', ''), Column('ms', 'time', 'ms')),
                tuple(times),
            ),
            Table(
                'Ratios',
                (
                    Column('what', ''),
                    Column('most', 'at most'),
                    Column('found', 'found'),
                    Column('met', 'met'),
                ),
                tuple(goals),
            ),
        ]

    def to_dict(self) -> dict[str, object]:
        """All as values for JSON."""
        return {
            **({'path': self.path} if self.path else {}),
            'rounds': self.rounds,
            'duration_s': self.duration_s,
            'ms': {key: 1e-3 * t.median_us for key, t in self.timings.items()},
            'first_pass': self.one_pass,
            'further_pass': self.further,
            'gtsam': self.peer,
            'agreement_sigma': None if np.isnan(self.agreement) else self.agreement,
        }


def run(
    rounds: int = 5,
    duration_s: float = DURATION_S,
    report: Callable[[str], None] = lambda _: None,
) -> SmoothBenchmark:
    """Times of all entries, after a comparison of the results.

    Raises
    ------
    Disagreement
        When GTSAM finds something else.
    """
    params, inputs = _mission(duration_s)
    entries = _entries(params, inputs)
    agreement = float('nan')
    if find_spec('gtsam') is None:
        report('GTSAM is not installed (pip install gtsam): the smoother stands alone')
    else:
        report('comparing with GTSAM')
        linear = linear_run(params, inputs)
        steps = linear.steps.tolist()
        mean, sigma = FactorGraph(linear).solve(steps)
        a = linear.active
        off = np.abs(linear.mean - mean)[:, a] / sigma[:, a]
        spread = np.abs(linear.sigma[:, a] / sigma[:, a] - 1.0)
        agreement = float(max(off.max(), spread.max()))
        if not agreement <= BOUND:
            raise Disagreement(f'GTSAM differs by {agreement:.3g} sigma, over {BOUND}')
        entries.append(Entry('gtsam', 'GTSAM', 1, lambda: FactorGraph(linear).solve(steps)))
    report('timing')
    return SmoothBenchmark(rounds, duration_s, interleave(entries, rounds), agreement)


def run_recorded(
    path: str,
    params: EngineParams,
    inputs: Inputs,
    rounds: int = 5,
    report: Callable[[str], None] = lambda _: None,
) -> SmoothBenchmark:
    """Times of the filter and of the passes over a recording, by themselves.

    Parameters
    ----------
    path : str
        Of the recording.
    params, inputs : EngineParams, Inputs
    rounds : int
    report : callable
    """
    entries = _entries(params, inputs)
    found = smoothing.smooth(params, inputs, passes=2, at_least=2)
    if found.passes < 2:
        why = found.unsettled or 'the first pass is the better one'
        report(f'{path}: there is no further pass to time ({why})')
        entries = entries[:-1]
    report(f'timing {path}')
    stamps = inputs.imu_stamps_ns
    duration_s = float(stamps[-1] - stamps[0]) * 1e-9
    return SmoothBenchmark(rounds, duration_s, interleave(entries, rounds), path=path)


def _entries(params: EngineParams, inputs: Inputs) -> list[Entry]:
    """What is timed of any run: the filter, and one pass and two of the smoother."""
    return [
        Entry('filter', 'filter', 1, partial(_filter, params, inputs)),
        Entry('one', 'smoother, one pass', 1, partial(_smooth, params, inputs, 1)),
        Entry('two', 'smoother, two passes', 1, partial(_smooth, params, inputs, 2)),
    ]


def _mission(duration_s: float) -> tuple[EngineParams, Inputs]:
    """Mission with late fixes, of which each is fused as stated: what GTSAM can do, too."""
    world = simulated(duration_s, _FIX_PERIOD_S)
    params = world.params(**AS_STATED)
    late_ns = round(_DELAY_S * 1e9)
    fixes = [replace(f, receive_ns=f.validity_ns + late_ns) for f in world.inputs.fixes]
    return params, replace(world.inputs, fixes=tuple(fixes))


def _filter(params: EngineParams, inputs: Inputs) -> None:
    engine_run.run(params, inputs, sink=lambda _: None, derived=True)


def _smooth(params: EngineParams, inputs: Inputs, passes: int) -> None:
    """Smooth in exactly so many passes."""
    smoothing.smooth(params, inputs, passes=passes, at_least=passes)
