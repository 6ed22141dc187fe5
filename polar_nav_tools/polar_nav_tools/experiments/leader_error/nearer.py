"""What would bring a follower nearer to the filter of both vehicles: fields, or states.

``python -m polar_nav_tools.experiments.leader_error.nearer`` prints RMS over that of `centralised`
for both followers of `two_vehicles`, with its leaders and `OTHERS`. In packets: fields that they
do not have, for the filter with the states of a leader and for the engine's three. In the filter,
from the packets as they are: other columns of the three states (`Shaped`), and a leader whose way
is turned by its present heading.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.sins.leader_drift import link

from . import leader as lead
from .experiment import SCENARIOS, Scenario
from .leader import Leader
from .two_vehicles import (
    CALM,
    OWN,
    SIGMAS,
    TAU_S,
    Filter,
    Line,
    Moment,
    Rows,
    across,
    both,
    expected,
    moments,
    stated_leader,
    three_states,
)

SHARE = 0.3
"""Of the stated variance that `Shaped` leaves the same along and across: read off leaders of the
experiment, and so judged by `OTHERS`."""
_BACK_S = 7200.0
OTHERS = (
    Scenario('0.07 %, racetrack', Leader().drift(7e-4), _BACK_S, 'racetrack'),
    Scenario('0.2 %, 4 h', Leader().drift(2e-3), 2.0 * _BACK_S),
    Scenario('5 mm/s, racetrack', Leader(slow_mps=0.005, slow_s=600.0), _BACK_S, 'racetrack'),
    Scenario('scale, racetrack', Leader(scale=0.005), _BACK_S, 'racetrack'),
    Scenario(
        'constant, racetrack', replace(Leader().drift(5e-3), heading_s=1e7), _BACK_S, 'racetrack'
    ),
)
"""Leaders unlike those that the filters were made for."""


class Shaped:
    """Columns of three states by the way of a leader that dead reckons, from packets alone.

    The heading's share of the position error is that of a Markov heading, whose past way is
    forgotten as the heading is; along the way, where a leader turns back, the error of its scale
    does so, too. Of what is stated `SHARE` stays as it is.
    """

    def __init__(self) -> None:
        self._way = np.zeros(2)
        self._faded = np.zeros(2)  # up x way, as far as the present heading has turned it
        self._turned = np.zeros((2, 2))  # covariance of the way per variance of heading
        self._slow = self._pulled = 0.0  # variance of a Markov velocity's way, and covariance
        self._linked = 1.0
        self._first = self._farthest = 0.0
        self._stamp_ns = 0

    def __call__(self, m: Moment, sigma: float, heading: float, columns: Array) -> Array:
        """Columns (2, 3), `two_vehicles.Shape`."""
        if not sigma > 0.0:
            return columns
        dt = (m.stamp_ns - self._stamp_ns) * 1e-9
        self._stamp_ns = m.stamp_ns
        self._first = self._first or sigma
        turn = across(m.way - self._way)
        self._way = m.way
        crossed = np.outer(turn, self._faded)
        self._turned = self._turned + crossed + crossed.T + np.outer(turn, turn)
        self._faded = (self._faded + turn) * math.exp(-dt / TAU_S)
        self._slow += (2.0 * self._pulled + dt) * dt
        self._pulled = (self._pulled + dt) * math.exp(-dt / Leader.slow_s)
        distance = math.hypot(*m.way)
        self._farthest = max(self._farthest, distance)
        self._linked = min(self._linked, link(heading * distance, sigma))
        grown = max(0.0, sigma**2 - self._first**2)
        rate = math.sqrt(grown) / self._farthest
        by_heading = self._linked * heading
        along = self._linked * min(rate, heading) + (1.0 - self._linked) * rate
        apart = (1.0 - self._linked) * rate * across(m.way)
        P = along**2 * np.outer(m.way, m.way) + np.outer(apart, apart)
        P += by_heading**2 * (self._turned - np.outer(self._faded, self._faded))
        P += (self._first**2 + min(Leader.slow_mps**2 * self._slow, grown)) * np.eye(2)
        A = columns.copy()
        A[:, :2] = _square_root((1.0 - SHARE) * P + SHARE * sigma**2 * np.eye(2))
        A[:, 2] = heading * across(m.line) + by_heading * self._faded
        return A


def _finer(m: Moment, sigma: float, heading: float, columns: Array) -> Array:
    """The engine's columns for sigmas as they were before a packet rounded them."""
    P, _, variance = m.hidden
    exact = math.sqrt(float(np.linalg.eigvalsh(P)[-1])), math.sqrt(variance)
    A = columns.copy()
    A[:, :2] *= exact[0] / sigma if sigma > 0.0 else 1.0
    A[:, 2] *= exact[1] / heading if heading > 0.0 else 1.0
    return A


def _covariance(m: Moment, sigma: float, heading: float, columns: Array) -> Array:
    """The engine's columns with the covariance of the horizontal position in the packet."""
    del sigma, heading
    A = columns.copy()
    A[:, :2] = _square_root(m.hidden[0])
    return A


def _correlated(m: Moment, sigma: float, heading: float, columns: Array) -> Array:
    """With its covariance with the heading besides."""
    P, with_heading, variance = m.hidden
    if not variance > 0.0:
        return _covariance(m, sigma, heading, columns)
    c = with_heading / math.sqrt(variance)
    A = columns.copy()
    A[:, :2] = _square_root(P - np.outer(c, c))
    A[:, 2] = math.sqrt(variance) * across(m.line) + c
    return A


def _by_present_heading(leader: Leader, fixes: Sequence[Moment]) -> Filter:
    """Filter as `both`, but the heading error of now has turned the whole way so far."""
    f = both(leader, fixes)
    heading = OWN + lead.HEADING

    def rows() -> Iterator[Rows]:
        for m, r in zip(fixes, f.rows, strict=True):
            Phi, H = r.Phi.copy(), r.H.copy()
            Phi[OWN : OWN + 2, heading] = 0.0
            H[:, heading] -= across(m.way)
            yield r._replace(Phi=Phi, H=H)

    return Filter(f.sigmas, rows())


def _square_root(P: Array) -> Array:
    variances, axes = np.linalg.eigh(P)
    return np.asarray((axes * np.sqrt(np.maximum(variances, 0.0))) @ axes.T)


def run(scenario: Scenario, own_sigmas: Array = SIGMAS) -> dict[str, tuple[Line, Line]]:
    """By name what is expected of each filter, with its own covariance and as published."""
    fixes = moments(scenario, own_sigmas)
    true, stated = scenario.leader, stated_leader(fixes)
    start, heading = true.start_m, true.heading_deg
    if stated.array_deg is None:
        finer = replace(stated, start_m=start, heading_deg=heading)
    else:
        finer = replace(stated, start_m=start, array_deg=true.array_deg or 0.0)
    times = replace(stated, heading_s=true.heading_s, slow_mps=true.slow_mps, slow_s=true.slow_s)
    filters = {
        'centralised': both(true, fixes),
        'structured': both(stated, fixes),
        'structured, finer': both(finer, fixes),
        'structured, scale': both(replace(stated, scale=true.scale), fixes),
        'structured, times': both(times, fixes),
        'present heading': _by_present_heading(stated, fixes),
        'packets': three_states(fixes),
        'packets, finer': three_states(fixes, _finer),
        'packets, covariance': three_states(fixes, _covariance),
        'packets, correlated': three_states(fixes, _correlated),
        'shaped': three_states(fixes, Shaped()),
    }
    return {name: expected(true, fixes, own_sigmas, f) for name, f in filters.items()}


def main() -> None:
    """Print a table of each follower."""
    rows = []
    for sigmas in (SIGMAS, CALM):
        rows.append(
            'leader                   filter               x centralised  NEES position  heading'
            '  published: position  heading'
        )
        for scenario in (*SCENARIOS, *OTHERS):
            found = run(scenario, sigmas)
            best = found['centralised'][0].rms
            for name, (own, published) in found.items():
                rows.append(
                    f'{scenario.name:24s} {name:20s} {own.rms / best:13.3f} {own.position:14.2f} '
                    f'{own.heading:8.2f} {published.position:20.2f} {published.heading:8.2f}'
                )
    print('\n'.join(rows))  # noqa: T201 - the output of a command


if __name__ == '__main__':
    main()
