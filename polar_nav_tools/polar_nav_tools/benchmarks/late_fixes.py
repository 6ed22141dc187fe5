"""One late fix in an engine whose history is full, and whole runs with late fixes.

The world is the straight run of the experiments: IMU at 100 Hz, DVL at 5 Hz, depth at 10 Hz. The
results of the strategies for the same fix are compared before any timing.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import attitude, grid
from polar_nav_core.arrays import Array
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Event, Fix
from polar_nav_core.engine.methods import DELAY_HANDLING
from polar_nav_core.engine.outputs import Output, Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.sins.fusion import Fusion
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.errors import PolarNavError

from ..experiments.schedule import FixSpec
from ..experiments.world import World, make_world
from ..experiments.world_spec import WorldSpec
from .navigation import Disagreement
from .rounds import Entry

AGES_S = (1.0, 5.0, 10.0, 20.0, 60.0)
RATES_HZ = (0.1, 1.0)
FILLED_S = 70.0
"""Run before the one late fix: longer than the history of the engine, 65 s."""

RUN_S = 300.0
RUN_STRATEGIES = ('back_propagate', 'clone', 'rewind')

BOUND = 0.01
"""Largest difference of `clone` and `rewind` [sigma]: linearized once, and anew."""

_FIRST_FIX_S = 3.0
_SEED = 1


def simulated(duration_s: float, fix_period_s: float = 0.5, first_s: float | None = None) -> World:
    """World of a duration [s], with fixes that are received when they are valid.

    The first is valid after ``first_s``, by default one period after the start.
    """
    spec = WorldSpec(
        duration_s=duration_s,
        imu='paper_6_2',
        imu_rate_hz=100.0,
        dvl_rate_hz=5.0,
        depth_rate_hz=10.0,
    )
    first_s = fix_period_s if first_s is None else first_s
    world = make_world(spec, FixSpec(period_s=fix_period_s, first_s=first_s), _SEED)
    return world.with_fixes(tuple(replace(fix, array_heading=0.0) for fix in world.inputs.fixes))


def engine_of(world: World, strategy: str, **changes: Any) -> Engine:  # noqa: ANN401
    """Engine with one strategy; ``changes`` are of EngineParams."""
    return Engine(_params(world, strategy, **changes))


def _params(world: World, strategy: str, **changes: Any) -> EngineParams:  # noqa: ANN401
    # No gate: `ignore` shall do the work for a fix that is off by speed times delay, too.
    chosen = {'configuration': 'custom', 'gate_probability': 1.0, **changes}
    return world.params(delay_handling=strategy, **chosen)


def aged(world: World, age_s: float) -> Fix:
    """Fix that was valid ``age_s`` before the last IMU sample, and is received now."""
    now_ns = int(world.inputs.imu_stamps_ns[-1])
    wanted = now_ns - round(age_s * 1e9)
    fixes = world.inputs.fixes
    fix = min(fixes, key=lambda one: abs(one.validity_ns - wanted))
    if abs(fix.validity_ns - wanted) > 1_000_000:
        raise ValueError(f'the world has no fix that is {age_s} s old at its end')
    return replace(fix, transmit_ns=now_ns, receive_ns=now_ns, arrival=len(fixes))


def before(world: World) -> list[Event]:
    """Events of the world without its fixes, except one at the start that is on time."""
    first = min(world.inputs.fixes, key=lambda one: abs(_age_s(world, one) - _FIRST_FIX_S))
    return list(replace(world.inputs, fixes=(first,)).events())


def _age_s(world: World, fix: Fix) -> float:
    return (fix.validity_ns - int(world.inputs.imu_stamps_ns[0])) * 1e-9


_Rows: TypeAlias = tuple[NDArray[Any], NDArray[np.intp], NDArray[Any]]
"""An array, numbers of rows in it, and their values before the fix."""


class Prepared:
    """Engine just before a fix, restored for every call.

    What a fix changed in the filter's arrays is copied back into place before the next call, and
    no more: copies of all ten to thirty megabytes would leave nothing in the processor's caches.
    Everything else of the engine is copied anew.

    Parameters
    ----------
    engine : Engine
        Taken over; it has a state.
    events : iterable of Event
        What it takes before the fix.
    """

    def __init__(self, engine: Engine, events: Iterable[Event]) -> None:
        drive(engine, events)
        self._engine = engine
        fusion = taken_over(engine)
        if fusion is None:
            raise PolarNavError(f'the engine has no state: {engine.divergence or "no IMU sample"}')
        f = fusion.filter
        groups = (f.state, f.frames, f.settings, f.past, f.work, f.log, f.streams)
        self._arrays: list[NDArray[Any]] = [
            a for group in groups for a in group if isinstance(a, np.ndarray) and a.size
        ]
        self._kept = [a.copy() for a in self._arrays]
        self._changed: dict[int, list[_Rows]] = {}
        self._taken: Fix | None = None
        self.engine = copy.deepcopy(engine, self._shared())

    def _shared(self) -> dict[int, Any]:
        return {id(array): array for array in self._arrays}

    def restore(self) -> None:
        """Restore the engine to its state before the fix."""
        if self._taken is not None:
            for array, rows, kept in self._rows(self._taken.validity_ns):
                array[rows] = kept
        self._taken = None
        self.engine = copy.deepcopy(self._engine, self._shared())

    def _rows(self, validity_ns: int) -> list[_Rows]:
        """Rows that the fix changes, the same in each call."""
        if validity_ns not in self._changed:
            found: list[_Rows] = []
            for array, kept in zip(self._arrays, self._kept, strict=True):
                same = array.reshape(len(array), -1) == kept.reshape(len(kept), -1)
                rows = np.flatnonzero(~same.all(axis=1))
                if len(rows):
                    found.append((array, rows, kept[rows]))
            self._changed[validity_ns] = found
        return self._changed[validity_ns]

    @property
    def restored(self) -> bool:
        """Whether all arrays are as they were before the fix."""
        return all(
            np.array_equal(array, kept, equal_nan=True)
            for array, kept in zip(self._arrays, self._kept, strict=True)
        )

    def take(self, fix: Fix) -> list[Output]:
        """Process the fix: the timed work."""
        self._taken = fix
        return list(self.engine.process(fix))


def drive(engine: Engine, events: Iterable[Event]) -> list[Output]:
    """All outputs of an engine for these events."""
    return [output for event in events for output in engine.process(event)]


# -- one late fix ---------------------------------------------------------------------------------


def prepared(world: World) -> dict[str, Prepared]:
    """One engine per strategy, its history full."""
    events = before(world)
    return {name: Prepared(engine_of(world, name), events) for name in DELAY_HANDLING}


def agreement(
    engines: dict[str, Prepared], world: World, ages_s: Sequence[float]
) -> dict[str, float]:
    """Largest difference of `clone` and `rewind` after the same late fix [sigma], for each age.

    Raises
    ------
    Disagreement
        When it is over BOUND, or a strategy does not fuse the fix.
    """
    found = {}
    for age_s in ages_s:
        fix = aged(world, age_s)
        ends = {}
        for name, one in engines.items():
            one.take(fix)
            one.restore()
            _require_fused(name, age_s, one.take(fix))
            ends[name] = _end(one.engine)
            one.restore()
            if not one.restored:
                raise PolarNavError(f'{name}: the engine is not what it was before the fix')
        found[f'{age_s:g} s'] = _distance(ends['clone'], ends['rewind'], f'{age_s:g} s')
    return found


def entries(
    engines: dict[str, Prepared], world: World, ages_s: Sequence[float]
) -> dict[float, list[Entry]]:
    """Entries of each age: the fix, taken by each strategy."""
    out: dict[float, list[Entry]] = {}
    for age_s in ages_s:
        fix = aged(world, age_s)
        out[age_s] = [
            Entry(f'{name}@{age_s:g}', name, 1, partial(one.take, fix), one.restore)
            for name, one in engines.items()
        ]
    return out


def taken_over(engine: Engine) -> Fusion | None:
    """Return the filter with its measurements; the engine gives no estimate that is due."""
    engine.due_ns = None
    return engine.fusion if isinstance(engine.fusion, Fusion) else None


@dataclass(frozen=True)
class _End:
    """Where a filter is, and how sure."""

    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array


def _end(engine: Engine) -> _End:
    fusion = taken_over(engine)
    if fusion is None:
        raise Disagreement(f'the filter stopped: {engine.divergence}')
    s = fusion.filter.state
    return _End(s.r_e.copy(), s.v_G.copy(), s.C_b_G.copy(), s.P.copy())


def _distance(a: _End, b: _End, what: str) -> float:
    """Largest difference of attitude, velocity, position and all sigmas, in sigmas of ``b``."""
    sigma = np.sqrt(np.diagonal(b.P))
    differences = np.concatenate(
        [
            attitude.log(a.C_b_G @ b.C_b_G.T),
            a.v_G - b.v_G,
            grid.ecef_to_grid(b.r_e) @ (a.r_e - b.r_e),
        ]
    )
    active = sigma > 0.0
    spread = np.sqrt(np.diagonal(a.P))[active] / sigma[active] - 1.0
    found = float(np.max(np.abs(np.concatenate([differences / sigma[:9], spread]))))
    if not found <= BOUND:
        raise Disagreement(f'{what}: clone and rewind differ by {found:.3g} sigma, over {BOUND}')
    return found


def _require_fused(name: str, age_s: float, outputs: Sequence[Output]) -> None:
    receipts = [o for o in outputs if isinstance(o, Receipt)]
    if not receipts or receipts[0].verdict is not Verdict.FUSED:
        why = receipts[0].reason if receipts else 'no receipt'
        raise Disagreement(f'{name} does not fuse a fix {age_s:g} s old: {why}')


# -- whole runs -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Runs:
    """The same run by each strategy, with late fixes at several rates; rate 0 is none.

    Parameters
    ----------
    world : World
    age_s : float
        How late every fix is received.
    rates_hz : sequence of float
        Fixes per second.
    """

    world: World
    age_s: float
    rates_hz: Sequence[float]

    def inputs(self, rate_hz: float) -> engine_run.Inputs:
        """Inputs with fixes at one rate."""
        x = self.world.inputs
        if rate_hz == 0.0:
            return replace(x, fixes=())
        end_ns, late_ns = int(x.imu_stamps_ns[-1]), round(self.age_s * 1e9)
        every = round(1.0 / rate_hz / self.world.fix_spec.period_s)
        fixes = [
            replace(
                fix, transmit_ns=fix.validity_ns + late_ns, receive_ns=fix.validity_ns + late_ns
            )
            for fix in x.fixes[every - 1 :: every]
            if fix.validity_ns + late_ns <= end_ns
        ]
        return replace(x, fixes=tuple(replace(fix, arrival=i) for i, fix in enumerate(fixes)))

    def run(self, strategy: str, inputs: engine_run.Inputs) -> engine_run.Result[engine_run.Track]:
        """Run to the end."""
        return engine_run.run(_params(self.world, strategy), inputs)

    def pass_through(self, strategy: str, inputs: engine_run.Inputs) -> None:
        """Run to the end and store nothing: memory for covariances is not timed."""
        engine_run.run(_params(self.world, strategy), inputs, sink=lambda _: None, derived=True)

    def agreement(self) -> dict[str, float]:
        """Largest difference of `clone` and `rewind` over the run [sigma], for each rate.

        Raises
        ------
        Disagreement
            When it is over BOUND, or a fix is not fused.
        """
        found = {}
        for rate_hz in self.rates_hz:
            what = f'fixes at {rate_hz:g} Hz'
            inputs = self.inputs(rate_hz)
            clone, rewind = self.run('clone', inputs), self.run('rewind', inputs)
            for name, result in (('clone', clone), ('rewind', rewind)):
                fused = sum(r.verdict is Verdict.FUSED for r in result.receipts)
                if result.divergence or not fused or fused < 0.99 * len(inputs.fixes):
                    why = result.divergence or f'{fused} of {len(inputs.fixes)} fused'
                    raise Disagreement(f'{what}: {name}: {why}')
            found[what] = max(
                _distance(_row(clone.track, k), _row(rewind.track, k), what)
                for k in range(0, len(rewind.track.stamps_ns), 10)
            )
        return found

    def entries(self, rate_hz: float) -> list[Entry]:
        """Entries of one rate, 0 for none: the run by each strategy."""
        inputs = self.inputs(rate_hz)
        return [
            Entry(f'{name}@{rate_hz:g}', name, 1, partial(self.pass_through, name, inputs))
            for name in RUN_STRATEGIES
        ]


def _row(track: engine_run.Track, k: int) -> _End:
    return _End(track.r_e[k], track.v_G[k], track.C_b_G[k], track.P[k])
