"""Verdicts on noise: what the data show, what they do not, and what is suggested."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from polar_nav_core.arrays import Array

from ..calibration.solve import EXCITED
from ..calibration.verdicts import Verdict
from ..scoring import Column, Table
from ..scoring.consistency import Consistency
from .classes import DECISIVE, GRADES, STATED, nearest
from .estimate import Tuned
from .judge import BAND, HeldOut
from .likelihood import Mask
from .parameters import IMU, Parameter

_CHANGED = 0.2
"""Logarithm of a factor from which on a number counts as another one, in words."""

_WORSE = 2.0
"""Ratio of NEES from which on suggested noise makes the filter less honest."""


@dataclass(frozen=True)
class Line:
    """One noise as judged.

    Attributes
    ----------
    parameter : Parameter
    value : float
        Most probable one, in the parameter's unit.
    sigma_share : float
        1-sigma that the data alone leave, as a share of it; infinite where they show nothing.
    at_most : float
        Largest that the data leave possible, where it is not estimated; infinite for any, NaN
        where it is estimated.
    verdict : Verdict
    refuted : bool
        Whether the stated number does not fit the data.
    suggested : float
        Number that is suggested in place of the stated one; that one where it may stay.
    why : str
        What would show it, or what it cannot be told from; empty where it is estimated.
    """

    parameter: Parameter
    value: float
    sigma_share: float
    at_most: float
    verdict: Verdict
    refuted: bool
    suggested: float
    why: str

    @property
    def changes(self) -> bool:
        """Whether another number than the stated one is suggested."""
        return self.suggested != self.parameter.stated


def lines_of(found: Tuned) -> tuple[Line, ...]:
    """Lines of all noises, in their order."""
    sigma, estimated = found.sigma, found.estimated
    least = np.array([p.least_sigma for p in found.parameters])
    twins = inseparable(found.fit.covariance, found.fit.prior, estimated, least)
    out = []
    for k, parameter in enumerate(found.parameters):
        verdict, why = Verdict.ESTIMATED, ''
        if k in twins:
            verdict = Verdict.INSEPARABLE
            why = f'known only together with {found.parameters[twins[k]].label}'
        elif not estimated[k]:
            verdict, why = Verdict.NOT_EXCITED, f'would show it: {parameter.show}'
        if not estimated[k] and found.refuted[k]:
            why += f'; what is stated, {parameter.stated:.3g}, does not fit'
        out.append(
            Line(
                parameter,
                parameter.stated * math.exp(found.fit.at[k]),
                float(sigma[k]),
                parameter.stated * math.exp(found.at_most[k]),
                verdict,
                bool(found.refuted[k]),
                parameter.stated * math.exp(found.suggested[k]),
                why,
            )
        )
    return tuple(out)


def inseparable(
    covariance: Array, prior: Array, estimated: Mask, least_sigma: Array
) -> dict[int, int]:
    """Noises that are not estimated but would be if another one was known, and which that is.

    Parameters
    ----------
    covariance : (k, k) array
        Of the logarithms, with the prior.
    prior : (k,) array
        1-sigma before the data.
    estimated : (k,) array of bool
    least_sigma : (k,) array
        That no recording goes below.
    """
    out: dict[int, int] = {}
    for k in np.flatnonzero(~estimated).tolist():
        best, least = -1, EXCITED
        for other in range(len(prior)):
            if other == k:
                continue
            P = covariance[np.ix_([k, other], [k, other])]
            left = P[0, 0] - P[0, 1] ** 2 / P[1, 1]
            data = 1.0 / left - 1.0 / prior[k] ** 2
            sigma = max(1.0 / math.sqrt(data), least_sigma[k]) if data > 0.0 else math.inf
            share = sigma / prior[k]
            if share < least:
                best, least = other, share
        if best >= 0:
            out[k] = best
    return out


def sentence(found: Tuned, lines: tuple[Line, ...]) -> str:
    """What the recording says of the IMU in a sentence."""
    mine = [line for line in lines if line.parameter.name in IMU]
    known = [line for line in mine if line.verdict is Verdict.ESTIMATED]
    stated_class = nearest(
        found.parameters, np.zeros(len(lines)), np.where(_is_imu(found), 0.0, math.inf)
    )
    stated = f'IMU: stated noise is like `{stated_class}` ({GRADES[stated_class]})'
    best, as_stated = found.classes[0], next(c for c in found.classes if c.name == STATED)
    by = best.ln_likelihood - as_stated.ln_likelihood
    if best.name == STATED or by < DECISIVE:
        if not known:
            return f'{stated}; the data cannot tell how noisy it is'
        return f'{stated}; no other class explains the data better'
    words = [
        f'{line.parameter.doc} {_times(line.value / line.parameter.stated)}'
        for line in known
        if abs(math.log(line.value / line.parameter.stated)) > _CHANGED
    ]
    shown = f'the data show {", ".join(words)}; ' if words else ''
    gain = f'ln likelihood {by:.0f} more' if math.isfinite(by) else 'what is stated diverges'
    return (
        f'{stated}; {shown}of all classes `{best.name}`, {GRADES[best.name]}, explains the data '
        f'best ({gain})'
    )


def _is_imu(found: Tuned) -> Mask:
    return np.array([p.name in IMU for p in found.parameters])


def _times(factor: float) -> str:
    return f'{factor:.3g} x as large' if factor >= 1.0 else f'{1.0 / factor:.3g} x smaller'


def judgement(judged: HeldOut, *, suggested: bool) -> str:
    """What the part held out says, in a sentence."""
    if not suggested:
        return f'held out: the last {judged.seconds:.0f} s; nothing is suggested, nothing to judge'
    words = {
        'better': 'predict it better than what is stated',
        'worse': 'predict it WORSE than what is stated: leave it as stated',
        'alike': 'predict it as well as what is stated',
    }
    gain = f'{judged.gain:+.3g} ± {judged.gain_sigma:.2g}'
    return (
        f'held out: the last {judged.seconds:.0f} s, {judged.rows} numbers; the suggested ones '
        f'{words[judged.verdict]} (ln likelihood per number {gain})'
    )


def problems(found: Tuned) -> list[str]:
    """Sentences on what was not well; empty if all was."""
    out = []
    if found.instead is not None:
        out.append(found.instead.sentence)
    if not found.fit.settled:
        out.append('the noise still moved after the last step: no number is sure')
    if found.judged.verdict == 'worse':
        out.append('the part held out is predicted worse than with what is stated')
    out += less_honest(found.nees)
    out += [
        f'more than half of all measurements of {name} are grossly wrong: see its sign, axes, '
        'frame and clock before its noise'
        for name in found.mostly_wrong
    ]
    if not found.judged.rows:
        out.append('nothing was measured in the part held out: nothing judges')
    return out


def less_honest(found: Mapping[str, Mapping[str, Consistency]]) -> list[str]:
    """Sentence for each quantity of which the filter is surer than it may be, as suggested.

    With a NEES of the part held out beyond its band, and twice what it is with what is stated.
    """
    stated, suggested = found.get('stated', {}), found.get('suggested', {})
    out = []
    for name, c in suggested.items():
        now, before = c.mean_per_dof, stated[name].mean_per_dof
        if now > c.band_high and now > _WORSE * max(before, 1.0):
            out.append(
                f'with what is suggested the filter is less honest of its {name} in the part held '
                f'out: NEES per degree of freedom {before:.3g} -> {now:.3g}'
            )
    return out


def notes(found: Tuned) -> list[str]:
    """Sentences on what makes the result less sure than it looks."""
    out = []
    for name, count in found.left_out.items():
        out.append(f'{count} measurements of {name} are grossly wrong and do not count')
    beyond = [n for n in found.judged.nis if not n.inside]
    if beyond:
        each = ', '.join(
            f'{n.sensor} {n.suggested:.3g} ({n.band[0]:.3g} to {n.band[1]:.3g})' for n in beyond
        )
        out.append(
            f'NIS of the part held out is beyond the {100.0 * BAND:g} % band: {each}: noise that '
            'changes, is coloured or not normal, or an error that calibration would find'
        )
    if found.cut_s > 1.0:
        out.append(f'the last {found.cut_s:.0f} s did not count: only the first hour does')
    return out


def table(title: str, lines: tuple[Line, ...]) -> Table:
    """Table of the noises, a row each."""
    rows = []
    for line in lines:
        p = line.parameter
        row: dict[str, object] = {
            'name': p.label,
            'unit': p.unit,
            'stated': p.stated,
            'verdict': str(line.verdict),
        }
        if line.verdict is Verdict.ESTIMATED:
            row |= {'found': line.value, 'sigma': 100.0 * line.sigma_share}
        elif math.isfinite(line.at_most):
            row['at_most'] = line.at_most
        if line.changes:
            row['suggested'] = line.suggested
        rows.append(row)
    columns = (
        Column('name', 'noise'),
        Column('stated', 'stated'),
        Column('found', 'found', digits=3),
        Column('sigma', '1-sigma', '%', digits=2),
        Column('at_most', 'at most', digits=2),
        Column('suggested', 'suggested', digits=3),
        Column('unit', 'unit'),
        Column('verdict', 'verdict'),
    )
    return Table(title, columns, tuple(rows))


def nis_table(judged: HeldOut) -> Table:
    """Table of the NIS of the part held out, a row per sensor."""
    rows = tuple(
        {
            'sensor': n.sensor,
            'rows': n.rows,
            'stated': n.stated,
            'suggested': n.suggested,
            'low': n.band[0],
            'high': n.band[1],
            'inside': 'yes' if n.inside else 'no',
        }
        for n in judged.nis
    )
    columns = (
        Column('sensor', 'NIS held out'),
        Column('rows', 'numbers'),
        Column('stated', 'stated'),
        Column('suggested', 'suggested'),
        Column('low', 'band from'),
        Column('high', 'to'),
        Column('inside', 'in band'),
    )
    return Table('', columns, rows)


def nees_words(found: Mapping[str, Mapping[str, Consistency]]) -> list[str]:
    """Sentence on the NEES of the part held out; empty without a truth."""
    stated, suggested = found.get('stated', {}), found.get('suggested', {})
    if not stated or not suggested:
        return []
    each = ', '.join(
        f'{name} {stated[name].mean_per_dof:.3g} -> {c.mean_per_dof:.3g} '
        f'({c.band_low:.2g} to {c.band_high:.2g})'
        for name, c in suggested.items()
    )
    return [f'NEES per degree of freedom held out, stated -> suggested (95 % band): {each}']
