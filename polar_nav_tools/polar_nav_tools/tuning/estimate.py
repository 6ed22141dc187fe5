"""Finds the noise of a recording from its first part, and judges it by the last.

Derivation: docs/derivations/tuning.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Rank
from polar_nav_core.errors import ConfigError

from ..calibration.solve import EXCITED
from ..foreign.recording import Progress, Recording, until
from ..scoring.consistency import Consistency
from .classes import DECISIVE, ClassFit, at_class, judge_classes, preferred
from .classes import STATED as STATED_CLASS
from .instead import Instead, instead_of_noise
from .judge import STATED, SUGGESTED, HeldOut, held_out, nees
from .likelihood import Kept, Mask, Problem, Rows, noisier, plausible
from .parameters import PRIOR, Parameter, parameters_of, reserve_of
from .solve import MOST_STEPS, Fit, fit

TRAINED = 0.7
"""Share of a recording that noise is found from; the rest judges it."""
WARM_UP_S = 30.0
"""After the first measurement, the start still counts: this long is not counted."""
LONGEST_S = 3600.0
"""Of a longer recording the first hour counts: each run of the filter is of all of it."""
_LEAST_S = 20.0
_LEAST_ROWS = 100
_OFF = 2.0
"""Sigmas from which on an estimate differs from what is stated."""
_REFUTED = 4.5
"""Fall of the logarithm of the likelihood at which a stated number is refuted: 3 sigma."""
_BOUND = 2.0
"""The same for the largest number that the data leave possible: 2 sigma."""
_REACH, _HALVINGS = math.log(100.0), 4
_CHANGES, _REDECIDED = 2, 2
"""Classes of IMUs that the prior is tried to be about; rounds of what is grossly wrong."""


@dataclass(frozen=True, eq=False)
class Tuned:
    """Noise of a recording as found and judged.

    Attributes
    ----------
    parameters : tuple of Parameter
    fit : Fit
        Most probable noise.
    refuted : (k,) array of bool
        Whether the stated number does not fit the data, the others being as found.
    at_most : (k,) array
        Logarithm of the factor that the data leave possible at the most; infinite for any, NaN
        where the number is estimated.
    suggested : (k,) array
        Logarithms of factors that are suggested, zero to leave what is stated.
    classes : tuple of ClassFit
        Of the IMU, best first, other sensors as found.
    prior_class : str
        Class of the IMU that the prior is about, or `classes.STATED`.
    judged : HeldOut
    nees : mapping of str to mapping of str to Consistency
        Of the part held out, by ``stated`` and ``suggested`` and by quantity; empty without truth.
    left_out : mapping of str to int
        Measurements that are grossly wrong, by sensor.
    seconds : float
        That noise was found from.
    cut_s : float
        Length of the recording that did not count, at its end.
    instead : Instead or None
        What explains the recording in place of noise; nothing is suggested then.
    mostly_wrong : tuple of str
        Sensors of which more than half is left out.
    """

    parameters: tuple[Parameter, ...]
    fit: Fit
    refuted: Mask
    at_most: Array
    suggested: Array
    classes: tuple[ClassFit, ...]
    prior_class: str
    judged: HeldOut
    nees: Mapping[str, Mapping[str, Consistency]]
    left_out: Mapping[str, int]
    seconds: float
    cut_s: float
    instead: Instead | None = None
    mostly_wrong: tuple[str, ...] = ()

    @property
    def sigma(self) -> Array:
        """1-sigma of the logarithm of each that the data alone leave, shape (k,)."""
        return sigma_of(self.parameters, self.fit)

    @property
    def estimated(self) -> Mask:
        """Whether that is less than a share of the prior, shape (k,)."""
        return np.asarray(self.sigma < EXCITED * self.fit.prior)


def sigma_of(parameters: Sequence[Parameter], found: Fit) -> Array:
    """1-sigma of the logarithm of each noise that the data alone leave, shape (k,)."""
    least = np.array([p.least_sigma for p in parameters])
    return np.asarray(np.maximum(found.sigma, least))


def tune(run: Recording, progress: Progress = lambda _: None) -> Tuned:
    """Noise of a recording, judged by its last part.

    Raises
    ------
    ConfigError
        For parameters that have no linear steps, and for a recording that is too short, or in
        which nothing is measured.
    """
    params, stamps_ns = run.params, run.inputs.imu_stamps_ns
    stop_ns = int(stamps_ns[-1]) + 1
    end_ns = min(stop_ns, int(stamps_ns[0]) + round(LONGEST_S * 1e9))
    whole = until(run.inputs, end_ns)
    parameters_of(params, whole)  # refuses before a run
    kept = plausible(params, whole)
    parameters = parameters_of(params, kept.of(whole))
    first_ns = kept.first_ns
    length_s = (end_ns - first_ns) * 1e-9
    if length_s < _LEAST_S:
        raise ConfigError(
            f'{run.path}: {length_s:.0f} s with measurements are too short to tune by; '
            f'at least {_LEAST_S:.0f} s are needed, and ten minutes show more'
        )
    begin_ns = first_ns + round(min(WARM_UP_S, 0.1 * length_s) * 1e9)
    split_ns = first_ns + round(TRAINED * length_s * 1e9)
    counted = _Counted(progress, len(parameters))
    train = Problem(params, kept.of(whole), parameters, begin_ns, split_ns, counted)
    found, classes, prior_class = _most_probable(train, kept)
    for _ in range(_REDECIDED):
        # What the stated noise refuses may fit the one that was found.
        again = plausible(*noisier(params, whole, parameters, found.at))
        if again.alike(kept):
            break
        kept = again
        train = Problem(params, kept.of(whole), parameters, begin_ns, split_ns, counted)
        found = fit(train, found.at, found.prior_mean, found.prior)
        classes = judge_classes(train, found.at)
    if found.rows.dof.sum() < _LEAST_ROWS:
        raise ConfigError(f'{run.path}: {len(found.rows.ranks)} measurements are too few')
    estimated = sigma_of(parameters, found) < EXCITED * found.prior
    refuted = np.array(
        [not sure and _refutes(train, found, k) for k, sure in enumerate(estimated)]
    )
    at_most = np.array(
        [math.nan if sure else _at_most(train, found, k) for k, sure in enumerate(estimated)]
    )
    off = np.abs(found.at) > _OFF * sigma_of(parameters, found)
    # Of a number that is too large only so much is known: it is at most this.
    instead = np.where((found.at < 0.0) & np.isfinite(at_most), np.minimum(at_most, 0.0), found.at)
    suggested = np.where(estimated, np.where(off, found.at, 0.0), np.where(refuted, instead, 0.0))
    suggested = with_reserve(parameters, suggested)
    explained = instead_of_noise(train, found, suggested)
    if explained is not None:
        suggested = np.zeros(len(parameters))
    test = Problem(params, kept.of(whole), parameters, split_ns, end_ns, counted)
    nothing = np.zeros(len(parameters))
    judged = held_out(test.rows(nothing), test.rows(suggested), (end_ns - split_ns) * 1e-9)
    checked = replace(run, inputs=whole)
    errors = {
        name: nees(checked, parameters, at, split_ns)
        for name, at in ((STATED, nothing), (SUGGESTED, suggested))
    }
    progress(1.0)
    return Tuned(
        parameters=parameters,
        fit=found,
        refuted=refuted,
        at_most=at_most,
        suggested=suggested,
        classes=classes,
        prior_class=prior_class,
        judged=judged,
        nees=errors,
        left_out=kept.left_out(whole),
        seconds=(split_ns - begin_ns) * 1e-9,
        cut_s=(stop_ns - end_ns) * 1e-9,
        instead=explained,
        mostly_wrong=kept.mostly_wrong(whole),
    )


def with_reserve(parameters: Sequence[Parameter], at: Array) -> Array:
    """Logarithms of factors (k,) that take no random walk of a bias below the engine's default.

    That is a reserve for what a calm recording does not show: warmth, and the gravity of other
    places. A number that is stated smaller is left.
    """
    least = [math.log(r / p.stated) if (r := reserve_of(p)) else -math.inf for p in parameters]
    return np.maximum(at, np.minimum(least, 0.0))


class _Counted:
    """Calls a progress display for each run; the number of all is a guess."""

    def __init__(self, progress: Progress, parameters: int) -> None:
        self._progress, self._runs = progress, 0
        self._most = MOST_STEPS * (parameters + 2)

    def __call__(self) -> None:
        self._runs += 1
        self._progress(min(0.99, self._runs / self._most))


def _most_probable(train: Problem, kept: Kept) -> tuple[Fit, tuple[ClassFit, ...], str]:
    """Most probable noise, the classes of IMUs there, and the class that its prior is about."""
    nothing = np.zeros(len(train.parameters))
    prior = nothing + PRIOR
    start, name, best = nothing, STATED_CLASS, -math.inf
    for sensors in (nothing, _as_they_scatter(train.parameters, kept)):
        classes = judge_classes(train, sensors)
        chosen = preferred(classes)
        value = next(c.ln_likelihood for c in classes if c.name == chosen)
        if value > best:
            start, name, best = at_class(train.parameters, sensors, chosen), chosen, value
    for _ in range(_CHANGES):
        found = fit(train, start, at_class(train.parameters, nothing, name), prior)
        classes = judge_classes(train, found.at)
        mine = next(c for c in classes if c.name == name)
        if classes[0].ln_likelihood <= mine.ln_likelihood + DECISIVE:
            break
        name, start = classes[0].name, found.at
    return found, classes, name


def _as_they_scatter(parameters: Sequence[Parameter], kept: Kept) -> Array:
    """Logarithms of factors (k,) with the noise of sensors as large as their innovations are."""
    ranks = {'dvl_sigma': Rank.DVL, 'depth_sigma': Rank.DEPTH, 'fix_sigma': Rank.FIX}
    return np.array(
        [
            0.5 * math.log(kept.larger[ranks[p.name]]) if p.name in ranks else 0.0
            for p in parameters
        ]
    )


def _likelihood(rows: Rows | None) -> float:
    return -math.inf if rows is None else float(rows.ln_density().sum())


def _refutes(train: Problem, found: Fit, k: int) -> bool:
    """Whether a stated number falls out of what the data leave, the others as found."""
    if found.at[k] == 0.0:
        return False
    at = found.at.copy()
    at[k] = 0.0
    return _likelihood(train.rows(at)) < found.ln_likelihood - _REFUTED


def _at_most(train: Problem, found: Fit, k: int) -> float:
    """Logarithm of the largest factor that the data leave possible, the others as found."""

    def fits(value: float) -> bool:
        at = found.at.copy()
        at[k] = value
        return _likelihood(train.rows(at)) > found.ln_likelihood - _BOUND

    low, high = float(found.at[k]), float(found.at[k]) + _REACH
    if fits(high):
        return math.inf
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return high
