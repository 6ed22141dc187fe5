"""What would bring a follower nearer to the filter of both vehicles: fields, or states.

``python -m polar_nav_tools.experiments.leader_error.nearer`` prints RMS over that of `centralised`
for both followers of `two_vehicles`, with its leaders and `OTHERS`. In packets: fields that they
do not have, for the filter with the states of a leader and for the engine's three. In the filter,
from the packets as they are: the three states of up to engine 26 (`round`), and a leader whose way
is turned by its present heading.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from polar_nav_core.arrays import Array

from . import leader as lead
from .experiment import SCENARIOS, Scenario
from .leader import Leader
from .two_vehicles import (
    CALM,
    OWN,
    SIGMAS,
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

_BACK_S = 7200.0
OTHERS = (
    Scenario('0.07 %, racetrack', Leader().drift(7e-4), _BACK_S, 'racetrack'),
    Scenario('0.2 %, 4 h', Leader().drift(2e-3), 2.0 * _BACK_S),
    Scenario('5 mm/s, racetrack', Leader(slow_mps=0.005, slow_s=600.0), _BACK_S, 'racetrack'),
    Scenario('scale, racetrack', Leader(scale=0.005), _BACK_S, 'racetrack'),
    Scenario(
        'constant, racetrack', replace(Leader().drift(5e-3), heading_s=1e7), _BACK_S, 'racetrack'
    ),
    Scenario('0.1 %, wanders', replace(Leader().drift(1e-3), heading_s=1500.0), _BACK_S),
    Scenario(
        '0.3 %, circling', replace(Leader().drift(3e-3), range_m=1500.0, place='circling'), _BACK_S
    ),
    Scenario(
        '0.5 %, 5 m, racetrack', replace(Leader().drift(5e-3), start_m=5.0), _BACK_S, 'racetrack'
    ),
    Scenario('0.1 %, 4 mm/s', Leader(slow_mps=0.004, slow_s=900.0).drift(1e-3), _BACK_S),
    Scenario('0.2 %, racetrack, 4 h', Leader().drift(2e-3), 2.0 * _BACK_S, 'racetrack'),
    Scenario('1 %, 1 h', Leader().drift(1e-2), 0.5 * _BACK_S),
    Scenario('0.07 %, 4 h', Leader().drift(7e-4), 2.0 * _BACK_S),
    Scenario(
        '0.15 %, ahead, array', Leader(array_deg=0.3, place='ahead').drift(1.5e-3), 0.5 * _BACK_S
    ),
)
"""Leaders unlike those that the filters were made for; none from '0.1 %, wanders' on was looked at
before shares and times of the engine's columns (`Way`) stood."""


BETWEEN = tuple(
    Scenario(f'{100.0 * share:g} %, {minutes} min', Leader().drift(share), 60.0 * minutes)
    for share in (3e-4, 1e-3, 2e-3, 3e-3, 1e-2)
    for minutes in (30, 60, 120)
)
"""Leaders that drift by more, less or between, and sail straight: judged, never tuned on."""


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
        'round': three_states(fixes, tau_s=3600.0, shaped=False),
    }
    return {name: expected(true, fixes, own_sigmas, f) for name, f in filters.items()}


def between(scenario: Scenario, own_sigmas: Array) -> tuple[float, float, float, float]:
    """RMS of the engine's three states x structured and x centralised, NEES, and `round`.

    NEES is the larger one of position and heading, published; `round` is x structured.
    """
    fixes = moments(scenario, own_sigmas)
    filters = (
        both(scenario.leader, fixes),
        both(stated_leader(fixes), fixes),
        three_states(fixes),
        three_states(fixes, tau_s=3600.0, shaped=False),
    )
    lines = [expected(scenario.leader, fixes, own_sigmas, f) for f in filters]
    best, given, packets, before = (own.rms for own, _ in lines)
    published = lines[2][1]
    nees = max(published.position, published.heading)
    return packets / given, packets / best, nees, before / given


def main() -> None:
    """Print a table of each follower, and one of leaders between."""
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
    rows.append('leader, follower  x structured  x centralised  NEES  round: x structured')
    for number, sigmas in enumerate((SIGMAS, CALM), 1):
        for scenario in BETWEEN:
            ratios = '  '.join(f'{x:.3f}' for x in between(scenario, sigmas))
            rows.append(f'{scenario.name:20s} {number}  {ratios}')
    print('\n'.join(rows))  # noqa: T201 - the output of a command


if __name__ == '__main__':
    main()
