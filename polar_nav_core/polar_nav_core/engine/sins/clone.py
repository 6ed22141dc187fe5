"""`clone`: late fixes exactly, on the linearization that was stored when the inputs came.

A fix is carried from its time to the present through blocks of stored steps, and changes what is
stored on its way (kernels.sins.late_fuse). That gives what a filter with explicitly augmented
states gives, in any order of arrival. Gates and linearization stay as they were decided.
"""

from __future__ import annotations

import numpy as np

from ...kernels.sins import late_fuse, late_run
from ...kernels.sins import state as fs
from ...kernels.sins.blocks import make_blocks
from ...machine_code import Direct
from ..events import Fix, InitialState
from ..level import degrees_of_freedom
from ..params import EngineParams
from ..results import FixResult
from .filter import NavigationFilter
from .fusion import Fusion
from .log import STEPS_PER_BLOCK


class Clone(Fusion):
    """Late fixes through blocks of stored linear steps.

    Parameters
    ----------
    params, initial, stamp_ns
        As for :class:`Fusion`.
    """

    def __init__(self, params: EngineParams, initial: InitialState, stamp_ns: int) -> None:
        super().__init__(params, initial, stamp_ns)
        self._blocks = make_blocks(self.filter.log, STEPS_PER_BLOCK)
        self._note = np.zeros(3, dtype=np.int64)
        self._run = Direct(late_run.advance_late)

    def make_filter(
        self, params: EngineParams, initial: InitialState, stamp_ns: int
    ) -> NavigationFilter:
        """Return a filter that logs its linear steps."""
        return NavigationFilter(params, initial, stamp_ns, steps=True)

    def fix(self, fix: Fix) -> FixResult | None:
        """Fuse a fix where it belongs; None when that is no longer stored."""
        f = self.filter
        f.reach(fix.receive_ns)
        split = f.leader.split(fix)
        f.work.dof[0] = degrees_of_freedom(fix)
        code = late_run.take_late(
            *f.parts,
            self._blocks,
            fix.validity_ns,
            fix.r_e,
            split.covariance_e,
            fix.array_heading,
            fix.relative_e,
            split.common_e,
            self._note,
        )
        if code == late_fuse.OUT_OF_REACH:
            return None
        f.check(code)
        return FixResult(f.fix_outcome(fused=code == fs.FUSED), int(self._note[0]))

    @property
    def takes_fixes(self) -> bool:
        """Late fixes in the streams are fused."""
        return True

    def advance(self, until_ns: int, until_rank: int) -> int:
        """Process what stands in the streams before a place, late fixes too."""
        f = self.filter
        others = f.log, f.streams, f.rows
        given = *f.parts, self._blocks, f.streams, until_ns, until_rank, f.rows
        code = self._run.call(others, *given)
        f.check(code)
        return int(code)
