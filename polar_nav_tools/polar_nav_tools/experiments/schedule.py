"""Schedule of fixes: their times of validity and reception, by period, random delay and loss.

Random delays and losses do not depend on any filter, so that all configurations of one seed
receive the same fixes. The clairvoyant schedule is the same fixes, each received when valid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.inputs import Stamps
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import choice, param
from polar_nav_sim.section import Spec

DELAY_KINDS = ('constant', 'steps', 'uniform', 'steps_lossy')


@dataclass(frozen=True)
class FixSpec(Spec):
    """Specification of a leader's position fixes of a follower: period, noise, delay, loss."""

    period_s: float = param(0.1, 's', 0.01, 3600.0, 'Between times of validity')
    first_s: float = param(0.1, 's', 0.0, 1e6, 'First time of validity after the start')
    sigma: float = param(1.0, 'm', 0.0, 1e4, 'White noise per horizontal axis, 1-sigma')
    sigma_vertical: float = param(0.3, 'm', 0.0, 1e4, 'White noise along up, 1-sigma')
    delay_kind: str = choice(
        'constant',
        DELAY_KINDS,
        'constant: delay_s each; steps: i T with i uniform in 1..delay_steps, each fix delivered'
        ' once; uniform: between delay_least_s and delay_s; steps_lossy: at each step k the fix'
        ' k - i is read, so that some are never read and repeats are dropped',
    )
    delay_s: float = param(0.0, 's', 0.0, 120.0, 'Constant or longest delay')
    delay_least_s: float = param(0.0, 's', 0.0, 120.0, 'Shortest delay (uniform)')
    delay_steps: int = param(20, '', 1, 1200, 'D: longest delay in steps of step_s')
    step_s: float = param(0.1, 's', 0.001, 10.0, 'T: length of a delay step')
    loss: float = param(0.0, '', 0.0, 0.999, 'Share of the fixes that never arrive')
    leader_sigma: float = param(
        0.0, 'm', 0.0, 1e4, "Constant error of the leader's position per horizontal axis, per run"
    )

    @property
    def mean_delay_s(self) -> float:
        """Expected delay [s]."""
        if self.delay_kind == 'constant':
            return self.delay_s
        if self.delay_kind == 'uniform':
            return 0.5 * (self.delay_least_s + self.delay_s)
        return 0.5 * (self.delay_steps + 1) * self.step_s

    @property
    def longest_delay_s(self) -> float:
        """Longest possible delay [s]."""
        if self.delay_kind in ('constant', 'uniform'):
            return self.delay_s
        return self.delay_steps * self.step_s


def validity_times(spec: FixSpec, start_ns: int, end_ns: int) -> Stamps:
    """Times of validity from ``start_ns + first_s`` to ``end_ns`` [ns]."""
    period_ns = round(spec.period_s * 1e9)
    first_ns = start_ns + round(spec.first_s * 1e9)
    return np.arange(first_ns, end_ns + 1, period_ns, dtype=np.int64)


def delays_ns(spec: FixSpec, count: int, rng: np.random.Generator) -> Stamps:
    """Delay of each fix [ns], shape (count,); -1 for a fix that never arrives."""
    if spec.delay_kind == 'constant':
        out = np.full(count, round(spec.delay_s * 1e9), dtype=np.int64)
    elif spec.delay_kind == 'uniform':
        low, high = round(spec.delay_least_s * 1e9), round(spec.delay_s * 1e9)
        out = rng.integers(low, max(low, high), count, endpoint=True)
    else:
        steps = rng.integers(1, spec.delay_steps, count, endpoint=True)
        if spec.delay_kind == 'steps_lossy':
            if spec.period_s != spec.step_s:
                raise ConfigError(
                    f'parameter period_s: {spec.period_s} s; steps_lossy needs a fix per step of'
                    f' {spec.step_s} s'
                )
            steps = _read_back(steps)
        out = steps * round(spec.step_s * 1e9)
        out[steps < 0] = -1
    out[rng.random(count) < spec.loss] = -1
    return out


def _read_back(steps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Age at which fix j is first read, when step k reads fix k - steps[k]; -1: never."""
    out = np.full(len(steps), -1, dtype=np.int64)
    for k, i in enumerate(steps):
        if k >= i and out[k - i] < 0:
            out[k - i] = i
    return out


def clairvoyant(fixes: tuple[Fix, ...]) -> tuple[Fix, ...]:
    """The same fixes, each received at its time of validity, as without any delay."""
    by_validity = sorted(fixes, key=lambda fix: fix.validity_ns)
    return tuple(
        replace(fix, transmit_ns=fix.validity_ns, receive_ns=fix.validity_ns, arrival=k)
        for k, fix in enumerate(by_validity)
    )


def fixes_of(
    validity_ns: Stamps, receive_ns: Stamps, r_e: Array, covariance_e: Array
) -> tuple[Fix, ...]:
    """Fixes in order of arrival, numbered by validity.

    Parameters
    ----------
    validity_ns, receive_ns : (n,) arrays
    r_e, covariance_e : (n, 3), (n, 3, 3) arrays
        ECEF [m], [m^2].
    """
    order = np.lexsort((validity_ns, receive_ns))
    return tuple(
        Fix(
            int(validity_ns[j]),
            int(receive_ns[j]),
            int(receive_ns[j]),
            'leader',
            int(j),
            int(j),
            arrival,
            r_e[j],
            covariance_e[j],
        )
        for arrival, j in enumerate(order)
    )
