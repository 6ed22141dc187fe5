"""What speaks against a smoothed track: constants that its recording shows to be stated wrong.

A smoother is surer than its filter, and a constant mistake (late fixes, a lever arm) is in all of
its track. Tests: `calibration.suspects`; size: `calibration.estimate`; effect: one more pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import PolarNavError
from polar_nav_core.grid import ecef_to_grid

from ..calibration.constants import CONSTANTS, Constant
from ..calibration.estimate import Estimated, estimate
from ..calibration.suspects import LONGEST_S, SURE, Suspect, suspects
from ..calibration.verdicts import problems
from ..foreign.recording import until
from ..series.vehicle import EstimateSeries

Again = Callable[[EngineParams, Inputs], EstimateSeries]
"""Smooths a run anew, in one pass."""
NOT_WELL = 1.0
"""Movement of the track, in its stated sigmas, from which on it is not well."""


@dataclass(frozen=True)
class Doubt:
    """A constant that is stated wrong.

    Attributes
    ----------
    constant : Constant
    value, sigma : float
        What has to be added to what is stated, in the constant's unit, and its 1-sigma.
    sigmas : float
        By how many sigmas it is off, of the estimate and of what is stated together.
    twins : tuple of Constant
        Others that would look nearly the same in this recording.
    """

    constant: Constant
    value: float
    sigma: float
    sigmas: float
    twins: tuple[Constant, ...]

    def sentence(self, bag: str, speed: float) -> str:
        """What is off, by how much, and the command that finds it; at a median speed [m/s]."""
        c = self.constant
        if c.name == 'delay':
            way, way_sigma = abs(self.value) * speed, self.sigma * speed
            side, age = ('behind', 'late') if self.value > 0.0 else ('ahead', 'early')
            said = (
                f'fixes lie {way:.2g} ± {way_sigma:.1g} m {side} along the track, as if '
                f'{abs(self.value):.3g} ± {self.sigma:.2g} s {age}'
            )
        else:
            said = f'{c.doc}: {self.value:+.3g} ± {self.sigma:.2g} {c.unit} beyond what is stated'
        names = ' or '.join(other.name for other in self.twins)
        also = f', which {names} would look like here' if names else ''
        return f'{said} ({self.sigmas:.0f} sigma){also}; ./polar calibrate {bag} --only {c.name}'


@dataclass(frozen=True)
class Doubts:
    """What speaks against a smoothed track.

    Attributes
    ----------
    found : tuple of Doubt
    moved_m, moved_sigma : float
        RMS over the track of how far it moves with all of these put right, horizontally, and the
        same in its stated sigmas; NaN with none, or where it could not be smoothed so.
    speed : float
        Median of the track [m/s].
    why_not : str
        Why nothing was looked for; empty where it was.
    misfits : tuple of str
        Sentences where constants are off and none makes the measurements fit (axes, noise).
    """

    found: tuple[Doubt, ...] = ()
    moved_m: float = math.nan
    moved_sigma: float = math.nan
    speed: float = math.nan
    why_not: str = ''
    misfits: tuple[str, ...] = ()

    @property
    def complaint(self) -> str:
        """Why the track is not well; empty where it is."""
        if self.misfits:
            return (
                'measurements contradict what is stated of sensors, and no constant explains it '
                f'({"; ".join(self.misfits)}): see axes, frame and noise, `./polar replay` or '
                '`./polar calibrate`'
            )
        if not self.found or self.moved_sigma <= NOT_WELL:
            return ''
        names = ', '.join(d.constant.name for d in self.found)
        if math.isnan(self.moved_sigma):
            return f'what is stated of {names} is wrong'
        return (
            f'what is stated of {names} is wrong: put right, the track moves by '
            f'{self.moved_m:.2g} m (RMS), {self.moved_sigma:.2g} of its stated sigmas'
        )

    def sentences(self, bag: str) -> list[str]:
        """One for each constant; ``bag`` and options name the recording."""
        return [d.sentence(bag, self.speed) for d in self.found]

    def to_dict(self, bag: str) -> dict[str, object]:
        """Values for JSON."""

        def number(x: float) -> float | None:
            return x if math.isfinite(x) else None

        return {
            'found': [
                {
                    'name': d.constant.name,
                    'add': d.value,
                    'sigma': d.sigma,
                    'unit': d.constant.unit,
                    'sigmas': d.sigmas,
                    'or': [c.name for c in d.twins],
                    'sentence': d.sentence(bag, self.speed),
                }
                for d in self.found
            ],
            'track_moves_m': number(self.moved_m),
            'track_moves_sigma': number(self.moved_sigma),
            'complaint': self.complaint,
            'misfits': list(self.misfits),
            'why_not': self.why_not,
        }


def doubts_of(
    params: EngineParams, inputs: Inputs, smoothed: EstimateSeries, again: Again
) -> Doubts:
    """What speaks against a smoothed track.

    Parameters
    ----------
    params, inputs : EngineParams, Inputs
        Of the run; of mode sins.
    smoothed : EstimateSeries
    again : callable
        Smooths it anew, with constants put right.
    """
    if params.model_aiding:
        return Doubts(why_not='with model_aiding constants are not tested')
    first_ns = int(inputs.imu_stamps_ns[0])
    part = until(inputs, first_ns + round(LONGEST_S * 1e9))
    try:
        seen = suspects(params, part)
        if not seen:
            return Doubts()
        chosen = tuple(c for c in CONSTANTS if any(s.constant is c for s in seen))
        sized = estimate(params, part, chosen)
    except PolarNavError as error:
        return Doubts(why_not=f'constants were not tested: {error}')
    if misfits := tuple(problems(sized)):
        return Doubts(misfits=misfits)
    found = confirmed(seen, sized)
    if not found:
        return Doubts()
    speed = float(np.median(np.linalg.norm(smoothed.v_G[:, :2], axis=1)))
    try:
        moved = _movement(smoothed, again(*_put_right(params, inputs, found)))
    except PolarNavError:
        moved = math.nan, math.nan
    return Doubts(found, *moved, speed=speed)


def confirmed(seen: Sequence[Suspect], sized: Estimated) -> tuple[Doubt, ...]:
    """Suspects that are as sure after several runs of the filter as they were after one."""
    out = []
    for s in seen:
        k = sized.constants.index(s.constant)
        value, sigma = float(sized.found.mean[k]), max(float(sized.found.sigma[k]), s.sigma)
        sigmas = abs(value) / math.hypot(sigma, s.least)
        if sigmas >= SURE:
            factor = s.constant.factor
            out.append(Doubt(s.constant, value * factor, sigma * factor, sigmas, s.twins))
    return tuple(out)


def _put_right(
    params: EngineParams, inputs: Inputs, found: Sequence[Doubt]
) -> tuple[EngineParams, Inputs]:
    for c in CONSTANTS:
        for d in found:
            if d.constant is c and c.move is not None:
                params, inputs = c.move(params, inputs, d.value / c.factor)
    return params, inputs


def _movement(one: EstimateSeries, other: EstimateSeries) -> tuple[float, float]:
    """RMS of the horizontal distance of two tracks [m], and in sigmas of the first per axis."""
    _, a, b = np.intersect1d(one.stamp_ns, other.stamp_ns, return_indices=True)
    if not len(a):
        return math.nan, math.nan
    C_e_G = np.asarray(ecef_to_grid(one.r_e[a]))
    d = np.einsum('nij,nj->ni', C_e_G, other.r_e[b] - one.r_e[a])[:, :2]
    P = one.P_position_G[a][:, :2, :2]
    square = np.einsum('ni,nij,nj->n', d, np.linalg.inv(P), d)
    return float(np.sqrt(np.mean(np.sum(d**2, axis=1)))), float(np.sqrt(np.mean(square) / 2.0))
