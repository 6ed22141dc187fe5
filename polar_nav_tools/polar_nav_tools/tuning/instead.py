"""What else than noise explains a recording: an error that lasts would be taken for noise.

With the noise that was found, constants (`calibration.suspects`), other axes of the DVL and of a
level IMU, and the other sign of depths are tried. Where one of them makes the recording more
likely, noise is found once more with it; where that is smaller, noise was blamed for it.
Derivation: docs/derivations/tuning.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import exp
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import PolarNavError
from polar_nav_ros.adapters import rotations

from ..calibration.constants import CONSTANTS
from ..calibration.move import Move, rpy_of
from ..calibration.suspects import SURE, Suspect, suspects
from .likelihood import Problem, Rows
from .parameters import Parameter
from .solve import Fit, fit

DECISIVE = 0.5 * SURE**2
"""Gain of the logarithm of the likelihood that is one of so many sigmas."""
BLAMED = math.log(1.5)
"""Fall of the logarithm of a noise with another explanation from which on it was blamed."""


@dataclass(frozen=True)
class Alternative:
    """Something other than noise that may be wrong.

    Attributes
    ----------
    words : str
        As in ``as if ...``.
    see : str
        What to look at, or the command that finds it.
    move : callable
        Parameters and inputs without it (`calibration.move`), by 1.
    """

    words: str
    see: str
    move: Move


@dataclass(frozen=True)
class Instead:
    """An explanation that noise is not needed beside.

    Attributes
    ----------
    alternative : Alternative
    gain : float
        Of the logarithm of the likelihood, each with its own most probable noise.
    smaller : tuple of (Parameter, float, float)
        Noises that are smaller with it: without it, and with it, in the parameter's unit.
    """

    alternative: Alternative
    gain: float
    smaller: tuple[tuple[Parameter, float, float], ...]

    @property
    def sentence(self) -> str:
        """What is wrong in place of the noise, and what shows it."""
        most = max(self.smaller, key=lambda s: s[1] / s[2])
        return (
            f'something else than noise is wrong: the recording is as if {self.alternative.words} '
            f'(ln likelihood {self.gain:+.0f}), and {most[0].label} is then {most[2]:.2g} in '
            f'place of {f"{most[1]:.2g} {most[0].unit}".strip()}: {self.alternative.see}, and '
            'tune again; nothing is suggested'
        )

    def to_dict(self) -> dict[str, object]:
        """Values for JSON."""
        return {
            'as_if': self.alternative.words,
            'see': self.alternative.see,
            'ln_likelihood_gain': self.gain,
            'smaller': [
                {'name': p.label, 'without': without, 'with': beside, 'unit': p.unit}
                for p, without, beside in self.smaller
            ],
        }


def instead_of_noise(train: Problem, found: Fit, suggested: Array) -> Instead | None:
    """What explains a recording better than the noise that was found for it; None without any.

    Parameters
    ----------
    train : Problem
    found : Fit
    suggested : (k,) array
        Logarithms of factors that would be suggested.
    """
    blamed = (suggested > BLAMED) & (found.at > BLAMED)
    if not blamed.any():
        return None
    best = _best(_axes(train), train, found, (1.0,))
    tried = [*_constants(train, found.at), *([] if best is None else [best.alternative])]
    best = _best(tried, train, found, (0.0, 0.5, 1.0))
    if best is None:
        return None
    other = fit(train.moved(best.alternative.move), best.at, found.prior_mean, found.prior)
    smaller = tuple(
        (p, p.stated * math.exp(found.at[k]), p.stated * math.exp(other.at[k]))
        for k, p in enumerate(train.parameters)
        if blamed[k] and found.at[k] - other.at[k] > BLAMED
    )
    gain = gain_of(other.rows, found.rows)
    return Instead(best.alternative, gain, smaller) if smaller and gain > DECISIVE else None


class _Tried(NamedTuple):
    """An alternative with a gain, and the noise that it was tried with."""

    alternative: Alternative
    gain: float
    at: Array


def _best(
    some: Iterable[Alternative], train: Problem, found: Fit, shares: Sequence[float]
) -> _Tried | None:
    """Alternative of the greatest decisive gain, with such shares of the noise; None without."""
    best: _Tried | None = None
    for one in some:
        moved = train.moved(one.move)
        for share in shares:
            gain = gain_of(moved.rows(share * found.at), found.rows)
            if gain > (DECISIVE if best is None else best.gain):
                best = _Tried(one, gain, share * found.at)
    return best


def gain_of(rows: Rows | None, beside: Rows) -> float:
    """Gain of the logarithm of the likelihood over other rows of the same measurements.

    Stamps that are moved take some over the ends: of each sensor the mean counts, times how many
    there were. Minus infinity where the filter is lost, or a sensor has other measurements.
    """
    if rows is None:
        return -math.inf
    total = 0.0
    for rank in np.unique(np.concatenate([rows.ranks, beside.ranks])):
        one, other = (r.ln_density()[r.ranks == rank] for r in (rows, beside))
        if abs(len(one) - len(other)) > _MOVED * len(other):
            return -math.inf
        total += len(other) * float(one.mean() - other.mean())
    return total


_MOVED = 0.1
"""Share of the measurements of a sensor that may have gone over the ends."""


def _constants(train: Problem, at: Array) -> Iterator[Alternative]:
    """Constants that a run shows with the noise as stated or as found, alone and together."""
    for noise in (0.0 * at, at):
        seen = _suspects(*train.noisier(noise))
        yield from (_of_constants([s]) for s in seen)
        if len(seen) > 1:
            yield _of_constants(seen)


def _axes(train: Problem) -> Iterator[Alternative]:
    """Axes of sensors that a recording has data about."""
    _, inputs = train.noisier(np.zeros(len(train.parameters)))
    if inputs.dvl_valid.any():
        for C in turns():
            yield Alternative(_turn_words('DVL', C), 'see `rotation` of the DVL', _turn_dvl(C))
        for yaw_deg in (90.0, 180.0, -90.0):
            C = exp(np.array([0.0, 0.0, math.radians(yaw_deg)]))
            yield Alternative(_turn_words('IMU', C), 'see `rotation` of the IMU', _turn_imu(C))
    if len(inputs.depth):
        yield Alternative('depths had the other sign', 'see `positive` of the depths', _negative)


def _suspects(params: EngineParams, inputs: Inputs) -> list[Suspect]:
    try:
        found = list(suspects(params, inputs))
    except PolarNavError:  # the filter is lost with such noise
        return []
    order = [c.name for c in CONSTANTS]
    return sorted(found, key=lambda s: order.index(s.constant.name))


def _of_constants(some: Sequence[Suspect]) -> Alternative:
    said = ', '.join(
        f'{s.constant.doc} {s.value * s.constant.factor:+.3g} {s.constant.unit}' for s in some
    )
    names = ''.join(f' --only {s.constant.name}' for s in some)

    def move(params: EngineParams, inputs: Inputs, size: float) -> tuple[EngineParams, Inputs]:
        for s in some:
            if s.constant.move is not None:
                params, inputs = s.constant.move(params, inputs, size * s.value)
        return params, inputs

    words = f'what is stated were off by this: {said}'
    return Alternative(words, f'`./polar calibrate{names}`', move)


def turns() -> tuple[Array, ...]:
    """Turns of a DVL (3, 3): axes with a name, those turned by 45 degrees, a mirrored axis."""
    level = [(roll, 0.0, yaw) for roll in (0.0, 180.0) for yaw in (45.0, 135.0, -135.0, -45.0)]
    named = [*rotations.all_named().values(), *map(rotations.from_rpy_deg, level)]
    mirrored = [np.diag(np.where(np.arange(3) == k, -1.0, 1.0)) for k in range(3)]
    return tuple(C for C in (*named, *mirrored) if not np.allclose(C, np.eye(3)))


def _turn_words(what: str, C: Array) -> str:
    if np.linalg.det(C) < 0.0:
        axis = 'xyz'[int(np.argmin(np.diag(C)))]
        return f'the {axis} axis of the {what} had the other sign'
    roll, pitch, yaw = (round(a, 3) + 0.0 for a in rpy_of(C))
    return (
        f'the {what} were turned in its mount, beyond what is stated, by roll, pitch, yaw '
        f'{roll:g}, {pitch:g}, {yaw:g} deg'
    )


def _turn_dvl(C: Array) -> Move:
    def move(params: EngineParams, inputs: Inputs, size: float) -> tuple[EngineParams, Inputs]:
        del size
        turned = np.ascontiguousarray(inputs.dvl_v_m @ C.T)
        P = np.ascontiguousarray(C @ inputs.dvl_covariance_m @ C.T)
        return params, replace(inputs, dvl_v_m=turned, dvl_covariance_m=P)

    return move


def _turn_imu(C: Array) -> Move:
    def move(params: EngineParams, inputs: Inputs, size: float) -> tuple[EngineParams, Inputs]:
        del size
        turned = (np.ascontiguousarray(x @ C.T) for x in (inputs.omega_ib_b, inputs.f_b))
        omega, f = turned
        return params, replace(inputs, omega_ib_b=omega, f_b=f)

    return move


def _negative(params: EngineParams, inputs: Inputs, size: float) -> tuple[EngineParams, Inputs]:
    del size
    return params, replace(inputs, depth=-inputs.depth)
