"""When fixes can show a fault at the earliest: what the best of all tests of them needs.

A test that knows what a fault does to each innovation, and when it began, but not its size, is at
J = Σ bₖᵀ Sₖ⁻¹ bₖ with √J sigmas of evidence: b is the innovation's difference to the run without
the fault, S its covariance there (as `visible` of the experiment `mismatch`). No filter that has
to find out what happened sees it sooner.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from .trace import Innovation

SIGMAS = 5.0
"""Evidence by which a fault is shown."""


class Shown(NamedTuple):
    """What fixes show of a fault.

    Attributes
    ----------
    time_s : float
        When they show it; NaN if they never do.
    sigmas : float
        Evidence of all of them.
    """

    time_s: float
    sigmas: float


def shown_by_fixes(
    clean: Mapping[tuple[str, int], Innovation],
    found: Mapping[tuple[str, int], Innovation],
    start_s: float,
) -> Shown:
    """When fixes that came since the start [s] of a fault show it, horizontally.

    ``clean`` and ``found`` are those of the run without and with it; one that is not in both, as
    it was lost or never judged, counts nothing.
    """
    evidence, time_s = 0.0, math.nan
    for name, fix in sorted(found.items(), key=lambda item: item[1].time_s):
        usual = clean.get(name)
        if usual is None or fix.time_s < start_s:
            continue
        axes = zip(fix.z_G, usual.z_G, usual.variance_G, strict=True)
        evidence += sum((z - z0) ** 2 / variance for z, z0, variance in axes)
        if math.isnan(time_s) and evidence >= SIGMAS**2:
            time_s = fix.time_s
    return Shown(time_s, math.sqrt(evidence))
