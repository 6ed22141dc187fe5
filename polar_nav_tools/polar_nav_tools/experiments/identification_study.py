"""Study of identified drag and current: errors and stated sigmas over seeds.

``python -m polar_nav_tools.experiments.identification_study [seeds]`` prints the table of
docs/identification.md from the station scenario as `polar_nav_sim.offline_station` simulates it: 6
degrees of freedom, fixes as they arrive, the nominal inertia of the navigation's model.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from polar_nav_core import attitude
from polar_nav_core.identification.identifier import Identifier
from polar_nav_core.identification.params import METHODS, IdentificationParams
from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_core.identification.result import Identification
from polar_nav_core.identification.triggers import OFFLINE
from polar_nav_core.identification.window import position_fix
from polar_nav_sim.offline_station import StationRun, StationScenario, simulate

from ..series.vehicle import Floats

_LOG = 10
"""Samples between logged ones of attitude and thrust; the simulation has 100 per second."""
_NAMED = 4
"""Number of parameters of both methods: d1x, d2x and the current."""
_BASE = StationScenario(duration_s=770.0)
CASES: dict[str, StationScenario] = {
    'full noise': _BASE,
    'quanta only': replace(_BASE, noise=0.0),
    'half of the packets lost': replace(_BASE, loss=0.5),
    'heading 2 deg off': replace(_BASE, heading_bias=np.deg2rad(2.0)),
    'thrust +-8 N': replace(_BASE, excitation=0.25),
    'slow current': replace(_BASE, current_change=0.3, current_turn=0.6),
}


@dataclass(frozen=True)
class Case:
    """One method on one scenario over seeds; rows d1x, d2x, V_x, V_y.

    Attributes
    ----------
    bias, spread, predicted : (4,) arrays
        Mean error, its standard deviation over seeds, root mean square of the stated 1-sigma.
    nees : float
        Mean of e' P^-1 e over 4: 1 for honest sigmas.
    seconds : float
        Mean processor time of an identification [s].
    """

    verdicts: Counter[str]
    bias: Floats
    spread: Floats
    predicted: Floats
    nees: float
    seconds: float


def identifier_of(run: StationRun, params: IdentificationParams) -> Identifier:
    """Return an identifier after all messages of a simulated run."""
    identifier = Identifier(params)
    stamps = run.start_ns + np.rint(run.t_s * 1e9).astype(np.int64)
    psi, pitch, _ = attitude.euler_from_matrix(run.C_b_G)
    for k in range(0, len(stamps), _LOG):
        stamp_ns = int(stamps[k])
        identifier.add_heading(
            stamp_ns, float(psi[k]), float(pitch[k]), float(run.omega_ib_b[k, 2])
        )
        identifier.add_control(stamp_ns, run.force_b[k])
    f = run.fixes
    for k, validity_s in enumerate(f.validity_s.tolist()):
        polar = PolarFix(
            station=f.station_position[k],
            station_heading=float(f.station_heading[k]),
            station_heading_sigma=float(f.station_heading_sigma[k]),
            range=float(f.range[k]),
            range_sigma=float(f.range_sigma[k]),
            bearing=float(f.bearing[k]),
            bearing_sigma=float(f.bearing_sigma[k]),
            sound_speed=float(f.sound_speed[k]),
        )
        at = min(int(validity_s / (run.t_s[1] - run.t_s[0])), len(stamps) - 1)
        z = run.station_depth - float(run.depth[at])
        identifier.add_fix(position_fix(run.start_ns + round(validity_s * 1e9), polar, z))
    return identifier


def study(scenario: StationScenario, method: str, seeds: int) -> Case:
    """Cases of identifications at the end of a scenario for seeds 0, 1, ..."""
    params = IdentificationParams()
    verdicts: Counter[str] = Counter()
    errors, sigmas, nees, spent = [], [], [], []
    for seed in range(seeds):
        run = simulate(scenario, seed)
        identifier = identifier_of(run, params)
        began = time.process_time()
        found = identifier.identify(0, OFFLINE, method)
        spent.append(time.process_time() - began)
        verdicts[found.verdict.name] += 1
        error, covariance = _error(run, found)
        errors.append(error)
        sigmas.append(np.sqrt(np.diag(covariance)))
        nees.append(float(error @ np.linalg.solve(covariance, error)) / _NAMED)
    return Case(
        verdicts,
        np.mean(errors, axis=0),
        np.std(errors, axis=0, ddof=1),
        np.sqrt(np.mean(np.square(sigmas), axis=0)),
        float(np.mean(nees)),
        float(np.mean(spent)),
    )


def _error(run: StationRun, found: Identification) -> tuple[Floats, Floats]:
    """Error of d1x, d2x and the current at the last fix, where a filter would use them."""
    end = int(np.searchsorted(run.t_s, (found.last_validity_ns - run.start_ns) * 1e-9))
    body = run.body
    truth = np.array([body.drag_linear[0], body.drag_quadratic[0], *run.current[end, :2]])
    return found.values[:_NAMED] - truth, found.covariance[:_NAMED, :_NAMED]


def main(seeds: int = 20) -> None:
    """Print the table as Markdown."""
    say = sys.stdout.write
    titles = 'case', 'method', 'verdicts', 'd1x', 'd2x', 'V_x', 'V_y', 'NEES/4', 'ms'
    say(f'| {" | ".join(titles)} |\n{"|---" * len(titles)}|\n')
    for name, scenario in CASES.items():
        for method in METHODS:
            c = study(scenario, method, seeds)
            verdicts = ', '.join(f'{v} {n}' for v, n in c.verdicts.most_common())
            cells = [
                f'{bias:+.{d}f} ± {spread:.{d}f} ({sigma:.{d}f})'
                for bias, spread, sigma, d in zip(
                    c.bias, c.spread, c.predicted, (1, 1, 4, 4), strict=True
                )
            ]
            say(
                f'| {name} | {method} | {verdicts} | {" | ".join(cells)} | {c.nees:.2f} | '
                f'{1e3 * c.seconds:.0f} |\n'
            )
            sys.stdout.flush()


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
