"""Filter that records its run, and may be run once more with what is known by then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ... import grid
from ...arrays import Array, Ints
from ...kernels.sins import hindsight as kernels
from ...kernels.sins import rings
from ...kernels.sins import state as fs
from ...kernels.sins.update import N
from ..events import Fix, InitialState
from ..params import EngineParams
from ..results import FixResult
from .filter import NavigationFilter
from .fusion import Ignore

FixName = tuple[int, ...]


@dataclass(frozen=True)
class Plan:
    """What is known before a filter runs once more.

    Attributes
    ----------
    stamps_ns, states : (n,), (n, 30) arrays
        Track to which it is held.
    dvl, depth : (pings,), (depths,) arrays
        BY_GATE, TO_FUSE or TO_REFUSE, by the numbers of usable ones in their streams.
    fixes : mapping of `fix_name` to FixPlan
        Fixes that are not in it are refused, and judged.
    """

    stamps_ns: Ints
    states: Array
    dvl: Ints
    depth: Ints
    fixes: Mapping[FixName, FixPlan]


class FixPlan(NamedTuple):
    """Whether a fix is fused, and what is added to its covariance, grid axes (3, 3) [m^2]."""

    fused: bool
    added_G: Array


_REFUSED = FixPlan(False, np.zeros((3, 3)))


def fix_name(fix: Fix) -> FixName:
    """Name of a fix within a run."""
    return fix.key


@dataclass
class FixLog:
    """Fixes that reached the filter, each with the enlargement of its innovation covariance."""

    fixes: list[Fix] = field(default_factory=list)
    enlargements: list[float] = field(default_factory=list)


class Recorded(Ignore):
    """Filter that logs its steps and updates; its fixes come when they are valid.

    Parameters
    ----------
    params, initial, stamp_ns : as of `Fusion`
    every : int
        Covariance steps from one stored state to the next.
    fixes : FixLog, optional
        Gets the fixes; with it refused measurements are logged, too.
    plan : Plan, optional
        Track and decisions of a filter that runs once more.
    """

    def __init__(
        self,
        params: EngineParams,
        initial: InitialState,
        stamp_ns: int,
        every: int,
        fixes: FixLog | None = None,
        plan: Plan | None = None,
    ) -> None:
        self._every, self._fixes, self._plan = every, fixes, plan
        super().__init__(params, initial, stamp_ns)
        if fixes is not None:
            self.filter.log.hindsight.keeps[0] = 1
        if plan is not None:
            self._hold(plan)

    def _hold(self, plan: Plan) -> None:
        """Begin on the track of a plan; where the filter began is its deviation."""
        f = self.filter
        hindsight = f.log.hindsight._replace(
            stamps=plan.stamps_ns,
            states=plan.states,
            deviations=np.zeros((len(f.log.snapshot_flat), N)),
            dvl=plan.dvl,
            depth=plan.depth,
        )
        f.log = f.log._replace(hindsight=hindsight)
        kernels.hold(f.state, f.log, f.work.x)
        f.begin()

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix, or log it as refused: by the gate, or as planned."""
        if self._fixes is None:
            return super().fix(fix)
        decision = self.filter.log.hindsight.fix
        fix, decision[0] = self._planned(fix)
        decision[1] = len(self._fixes.fixes)
        self._fixes.fixes.append(fix)
        result = super().fix(fix)
        self._fixes.enlargements.append(1.0 if result is None else result.outcome.inflation)
        return result

    def _planned(self, fix: Fix) -> tuple[Fix, int]:
        """Fix with the covariance that is planned, and who decides on it."""
        if self._plan is None:
            return fix, rings.BY_GATE
        planned = self._plan.fixes.get(fix_name(fix), _REFUSED)
        if planned.added_G.any():
            C_e_G = np.asarray(grid.ecef_to_grid(fix.r_e))
            added_e = C_e_G.T @ planned.added_G @ C_e_G
            fix = fix.believed_to(fix.covariance_e + added_e)
        return fix, rings.TO_FUSE if planned.fused else rings.TO_REFUSE

    @property
    def takes_fixes(self) -> bool:
        """Whether fixes can stand in the streams: where they are logged."""
        return self._fixes is not None

    def put(self, fix: Fix) -> None:
        """Append a fix to the streams, with what is decided of it and its number as notes."""
        f, log = self.filter, self._fixes
        k = int(f.streams.counts[fs.FIX - fs.IMU])
        fix, decision = self._planned(fix)
        super().put(fix)
        waiting = k - int(f.state.counters[fs.FIX])
        number = waiting + (0 if log is None else len(log.fixes))
        f.streams.fix_notes[k % len(f.streams.fix_notes), :2] = decision, number

    def settled(self, fixes: Sequence[Fix], outcomes: Array) -> None:
        """Log fixes that were decided in the streams."""
        if self._fixes is not None:
            self._fixes.fixes += fixes
            self._fixes.enlargements += outcomes[:, rings.ENLARGEMENT].tolist()

    def offset(self, fix: Fix) -> tuple[Array, float] | None:
        """As `Fusion.offset`; None where fixes are decided on already: nobody else judges them."""
        return None if self._plan is not None else super().offset(fix)

    def make_filter(
        self, params: EngineParams, initial: InitialState, stamp_ns: int
    ) -> NavigationFilter:
        """Filter with a log and states at every so many steps.

        No fix of it comes late: of what only those want, the newest is enough.
        """
        return NavigationFilter(
            params, initial, stamp_ns, steps=True, states_every=self._every, late=False
        )
