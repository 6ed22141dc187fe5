"""Verdicts on estimated constants, with what would show those that the data do not."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np

from ..scoring import Column, Table
from .constants import Constant
from .estimate import Estimated
from .solve import EXCITED, Sum, sums

_NONE_FITS = 400.0
"""Mean squared innovation, calibrated, from which on noise that is larger explains nothing."""
_FITS_WORSE = 100.0
"""The same, where as stated it was less: the constants contradict that sensor."""
_MISFIT = 2.0
"""Mean squared innovation from which on sigmas cannot be believed."""
_CORRELATED = 0.5
"""Correlations that are named."""


class Verdict(StrEnum):
    """Verdicts on a constant."""

    ESTIMATED = 'ESTIMATED'
    NOT_EXCITED = 'NOT_EXCITED'
    INSEPARABLE = 'INSEPARABLE'


@dataclass(frozen=True)
class Line:
    """One constant as judged.

    Attributes
    ----------
    constant : Constant
    value, sigma : float
        What has to be added to the stated one, in the constant's unit, and its 1-sigma.
    verdict : Verdict
    why : str
        What would show it, or what it cannot be told from; empty where it is estimated.
    """

    constant: Constant
    value: float
    sigma: float
    verdict: Verdict
    why: str


def lines_of(found: Estimated) -> tuple[Line, ...]:
    """Lines of all constants, in their order."""
    tied = sums(found.found, found.prior)
    sigma = found.found.sigma
    out = []
    for k, c in enumerate(found.constants):
        mine = [s for s in tied if k in (s.first, s.second)]
        verdict, why = Verdict.ESTIMATED, ''
        if mine:
            verdict = Verdict.INSEPARABLE
            why = '; '.join(sum_text(found.constants, s) for s in mine)
        elif sigma[k] >= EXCITED * found.prior[k]:
            verdict, why = Verdict.NOT_EXCITED, f'would show it: {c.show}'
        elif c.twin:
            verdict, why = Verdict.INSEPARABLE, f'the sum with the {c.twin}: assign it to one'
        value = float(found.found.mean[k])
        out.append(Line(c, value * c.factor, float(sigma[k]) * c.factor, verdict, why))
    return tuple(out)


def sum_text(constants: tuple[Constant, ...], s: Sum) -> str:
    """Sum of two constants in their units, as in ``dvl_yaw + heading_bias = 2.9 deg``."""
    a, b = constants[s.first], constants[s.second]
    weight = s.weight * a.factor / b.factor
    size = '' if abs(abs(weight) - 1.0) < 0.02 else f'{abs(weight):.3g} '
    sign = '-' if weight < 0.0 else '+'
    return (
        f'{a.name} {sign} {size}{b.name} = {s.value * a.factor:.3g} {a.unit} '
        f'(1-sigma {s.sigma * a.factor:.2g})'
    )


def correlations(found: Estimated) -> list[tuple[str, str, float]]:
    """Pairs of constants whose correlation is large, largest first."""
    rho = correlation(found)
    names = [c.name for c in found.constants]
    pairs = [
        (names[i], names[j], float(rho[i, j]))
        for i, j in combinations(range(len(names)), 2)
        if abs(rho[i, j]) >= _CORRELATED
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def correlation(found: Estimated) -> np.ndarray:
    """Correlations of the constants, shape (k, k)."""
    sigma = found.found.sigma
    return np.asarray(found.found.covariance / np.outer(sigma, sigma))


def problems(found: Estimated) -> list[str]:
    """Sentences on what was not well; empty if all was."""
    out = []
    if found.after.divergence:
        out.append(f'the filter diverged: {found.after.divergence}')
    if found.after.filters > 1:
        out.append('the filter was lost on the way and began anew: calibrate a part of the run')
    if not found.settled:
        out.append(f'the constants still moved after {found.rounds} runs')
    for name, (before, after) in found.misfits().items():
        if after > _NONE_FITS:
            out.append(
                f'no constant makes {name} fit: innovations are still {after:.2g} times as large '
                'as modelled (squared): axes, frame or noise are stated wrong'
            )
        elif after > max(_FITS_WORSE, before):
            out.append(
                f'with these constants {name} fits worse than as stated: innovations are '
                f'{after:.2g} times as large as modelled (squared), {before:.2g} before: '
                'something else is wrong, as a long gap of the IMU or its axes'
            )
    return out


def notes(found: Estimated) -> list[str]:
    """Sentences on what makes the result less sure than it looks."""
    out = []
    for name, (_, after) in found.misfits().items():
        if after > _MISFIT:
            out.append(
                f'innovations of {name} are {after:.2g} times as large as modelled (squared), and '
                'sigmas as if its noise were that large: state it, or look for what else is wrong'
            )
    refused = found.refused()
    if refused:
        out.append(f'{refused} fixes were refused by the gate and do not count')
    return out


def table(title: str, lines: tuple[Line, ...]) -> Table:
    """Table of the constants, a row each."""
    rows = []
    for line in lines:
        row: dict[str, object] = {
            'name': line.constant.name,
            'unit': line.constant.unit,
            'verdict': str(line.verdict),
        }
        if line.verdict is not Verdict.NOT_EXCITED:
            row['value'] = line.value
        row['sigma'] = line.sigma
        rows.append(row)
    columns = (
        Column('name', 'constant'),
        Column('value', 'add', digits=3),
        Column('sigma', '1-sigma', digits=2),
        Column('unit', 'unit'),
        Column('verdict', 'verdict'),
    )
    return Table(title, columns, tuple(rows))
