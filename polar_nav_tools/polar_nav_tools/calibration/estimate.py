"""Maximum-likelihood estimate of constants over repeated runs of the compiled filter.

A run gives the whitened innovations and how each moves with a constant; least squares gives the
step, the run is made again with the constants moved, until they stay. The filter's own states are
nuisance throughout, and so is each common error that is not calibrated, with its stated sigma.
Derivation: docs/derivations/calibration.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.innovations import Innovations
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.verdicts import Verdict

from .constants import Constant
from .problem import (
    MOST_ROUNDS,
    SENSORS,
    Noise,
    Problem,
    Progress,
    larger_noise,
    mean_square,
)
from .solve import EXCITED, Normal, excited, sums

_ENOUGH = 0.1
"""Another run is made until no constant moves by more than this share of its sigma."""
_SAME = 0.1
"""Change of a factor on noise that is none."""


@dataclass(frozen=True)
class Estimated:
    """Constants of a run as estimated.

    Attributes
    ----------
    constants : tuple of Constant
    found : Normal
        What is to be added to the stated constants, SI, in their order.
    prior : (k,) array
        1-sigma before the data.
    rounds : int
        Runs with all rows, each about the constants of the one before.
    settled : bool
        Whether the last one moved nothing.
    before, after : Innovations
        As stated, and with the constants moved.
    noise : mapping of Rank to float
        Factors on the variances of sensors in the latter, where they fit no better.
    """

    constants: tuple[Constant, ...]
    found: Normal
    prior: Array
    rounds: int
    settled: bool
    before: Innovations
    after: Innovations
    noise: Noise

    def misfits(self) -> dict[str, tuple[float, float]]:
        """Mean squared whitened innovation by sensor, before and after; 1 in a right model."""
        out = {}
        for rank, name in SENSORS.items():
            before = mean_square(self.before, rank)
            after = mean_square(self.after, rank) * self.noise.get(rank, 1.0)
            if math.isfinite(before) and math.isfinite(after):
                out[name] = (before, after)
        return out

    def refused(self) -> int:
        """Number of fixes that the gate refused in the last run."""
        return sum(r.verdict == Verdict.GATED for r in self.after.receipts)


def estimate(
    params: EngineParams,
    inputs: Inputs,
    constants: Sequence[Constant],
    *,
    progress: Progress = lambda _: None,
) -> Estimated:
    """Estimate constants from a run of the strapdown mode.

    Raises
    ------
    ConfigError
        For parameters that have no linear steps, and where nothing was measured.
    """
    problem = Problem(params, inputs, constants, progress)
    at = np.zeros(len(problem.moved))
    before = after = problem.run(at, {})
    noise, rounds = larger_noise(before, {}), 1
    if noise:
        after, rounds = problem.run(at, noise), 2
    found, settled = problem.solved(after, at), not (noise or len(at))
    while not settled and rounds < MOST_ROUNDS:
        last, noise = found, larger_noise(after, noise)
        at = problem.reachable(excited(last, problem.prior)[: len(at)], at)
        after, rounds = problem.run(at, noise), rounds + 1
        found = problem.solved(after, at)
        settled = _alike(larger_noise(after, noise), noise) and _stays(last, found, problem.prior)
    progress(1.0)
    rows = [problem.place(c) for c in constants]
    return Estimated(
        tuple(constants),
        Normal(found.mean[rows], found.covariance[np.ix_(rows, rows)]),
        np.array([c.prior for c in constants]),
        rounds,
        settled,
        before,
        after,
        noise,
    )


def _alike(one: Noise, other: Noise) -> bool:
    """Whether factors on noise are the same, but for noise of their own."""
    return all(abs(one.get(r, 1.0) / other.get(r, 1.0) - 1.0) < _SAME for r in SENSORS)


def _stays(last: Normal, found: Normal, prior: Array) -> bool:
    """Whether constants that the data show, alone or as a sum, have not moved but for noise."""
    by = found.mean - last.mean
    shown = found.sigma < EXCITED * prior
    for s in sums(found, prior):
        shown[[s.first, s.second]] = False
        if abs(by[s.first] + s.weight * by[s.second]) > _ENOUGH * s.sigma:
            return False
    return bool((np.abs(by) <= _ENOUGH * found.sigma)[shown].all())
