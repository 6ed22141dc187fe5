"""Measurements judged by the track that all others give; what a filter that runs once more does.

A filter judges a measurement by what came before it, a smoother by what came after it, too. The
residual to the track without the measurement, with the covariance of both, is compared with the
same gate. Equations: docs/derivations/smoother.md.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array, Bools, Ints
from ..kernels.sins import rings
from ..kernels.sins.left_out import normalize
from .events import Fix, Rank
from .outputs import Receipt
from .results import chi2_gate
from .sins.recorded import FixName, FixPlan, Plan, fix_name
from .sins.robust import THRESHOLDS, inflation
from .sins.stretch import Stretch
from .verdicts import Verdict

_JUDGED = [Rank.DEPTH, Rank.DVL, Rank.FIX]
OF_FIXES = ('residuals', 'covariances', 'S')
"""Columns of `Judged` that have a row for each fix only."""
_THRESHOLDS = np.array([math.inf, *(THRESHOLDS[m] for m in (1, 2, 3))])
_WEIGHTED = 1.1
"""A fix whose weight changes by a smaller factor is as before."""


@dataclass(frozen=True)
class Judged:
    """Measurements of one pass and their residuals to the track by all others.

    Of pings and depths, of which a day has a million, the normalized square is kept only.

    Attributes
    ----------
    ranks, samples, sizes, dof : (n,) arrays
        Sensor as `events.Rank`, number in its stream, rows, degrees of freedom.
    fused : (n,) bool array
    nis : (n,) array
        Normalized squares of the residuals with the noise in force; NaN where the covariance is
        not positive definite.
    residuals, covariances, S : (fixes, 3), (fixes, 3, 3), (fixes, 3, 3) arrays
        Of fixes, estimate minus measurement, grid axes [m]; covariance with common errors and the
        noise in force; innovation covariance in force, without common errors.
    """

    ranks: Ints
    samples: Ints
    sizes: Ints
    dof: Ints
    fused: Bools
    nis: Array
    residuals: Array
    covariances: Array
    S: Array

    @classmethod
    def of(cls, stretch: Stretch, residuals: Array, covariances: Array) -> Judged:
        """Measurements of a stretch but headings (and a model), which their gate judges."""
        ranks, sizes = stretch.ranks, stretch.sizes
        fused = stretch.kinds[stretch.kinds != rings.STEP] != rings.KEPT
        nis = _normalized(residuals, covariances, sizes)
        judged = np.logical_or.reduce([ranks == rank for rank in _JUDGED])
        own = slice(None) if judged.all() else judged  # nearly always no copies
        of_fix = ranks == Rank.FIX
        L = stretch.L[of_fix]
        return cls(
            ranks[own].astype(np.int8),
            stretch.samples[own].astype(np.int32),
            sizes[own].astype(np.int8),
            stretch.dof[own].astype(np.int8),
            fused[own],
            nis[own],
            residuals[of_fix],
            covariances[of_fix],
            np.einsum('nij,nkj->nik', L, L),
        )

    @property
    def of_fixes(self) -> Ints:
        """Places of the fixes, in the order of ``residuals``."""
        return np.flatnonzero(self.ranks == Rank.FIX)


def _normalized(e: Array, V: Array, sizes: Ints) -> Array:
    """e^T V^-1 e of each of n, of its first rows; NaN where V is not positive definite."""
    nis = np.empty(len(sizes))
    normalize(e, V, sizes.astype(np.int64), nis, np.empty((4, 3)))
    return nis


@dataclass(frozen=True)
class Decisions:
    """What is decided about the measurements of a pass with hindsight.

    Attributes
    ----------
    judged : Judged
    nis : (n,) array
        By their stated noise.
    fused : (n,) bool array
    added_G : (fixes, 3, 3) array
        What is added to the covariance of a fix far off, grid axes [m^2].
    reweighted : int
        Fixes whose weight is another one than in that pass.
    """

    judged: Judged
    nis: Array
    fused: Bools
    added_G: Array
    reweighted: int

    @property
    def changed(self) -> int:
        """Number of measurements of which that pass decided otherwise."""
        return int((self.fused != self.judged.fused).sum())


def decide(judged: Judged, gate_probability: float, robust: str, added_G: Array) -> Decisions:
    """Decisions by the residuals of a pass.

    Parameters
    ----------
    judged : Judged
    gate_probability : float
    robust : str
        Name of the weights of fixes far off (`sins.robust`).
    added_G : (fixes, 3, 3) array
        What the noise of that pass had besides the stated one.
    """
    stated = judged.covariances - added_G
    nis, at = judged.nis.copy(), judged.of_fixes
    nis[at] = _normalized(judged.residuals, stated, judged.sizes[at])
    fused = _by_gate(judged, nis, gate_probability)
    weighed = fused[at] & np.isfinite(nis[at])
    factors = np.ones(len(at))
    dof = judged.dof[at]
    far = weighed & (nis[at] > _THRESHOLDS[dof])
    pairs = zip(nis[at[far]].tolist(), dof[far].tolist(), strict=True)
    factors[far] = [inflation(robust, x, m) for x, m in pairs]
    more = np.where((factors > 1.0)[:, None, None], (factors - 1.0)[:, None, None] * stated, 0.0)
    before, now = (np.trace(stated + x, axis1=1, axis2=2)[weighed] for x in (added_G, more))
    reweighted = int((np.abs(np.log(before / now)) >= math.log(_WEIGHTED)).sum())
    return Decisions(judged, nis, fused, more, reweighted)


def decide_by_gate(judged: Judged, gate_probability: float) -> Decisions:
    """Decisions on fixes by the gate alone; their covariances are by the stated noise."""
    nis = _normalized(judged.residuals, judged.covariances, judged.sizes)
    fused = _by_gate(judged, nis, gate_probability)
    return Decisions(judged, nis, fused, np.zeros_like(judged.covariances), 0)


def _by_gate(judged: Judged, nis: Array, gate_probability: float) -> Bools:
    """What is fused by the gate; as before where the residual has no covariance."""
    gates = np.array([np.inf, *(chi2_gate(gate_probability, m) for m in (1, 2, 3))])
    return np.where(np.isfinite(nis), nis <= gates[judged.dof], judged.fused)


def added_by_weights(judged: Judged, enlargements: Sequence[float]) -> Array:
    """What weights added to the noise of fixes, (fixes, 3, 3); S is lambda times the stated."""
    factors = np.asarray(enlargements, dtype=np.float64)[judged.samples[judged.of_fixes]]
    return np.asarray((1.0 - 1.0 / factors)[:, None, None] * judged.S)


def added_by_plan(judged: Judged, plan: Plan, fixes: Sequence[Fix]) -> Array:
    """What a plan added to the noise of fixes, (fixes, 3, 3)."""
    out = np.zeros_like(judged.covariances)
    for k, sample in enumerate(judged.samples[judged.of_fixes].tolist()):
        planned = plan.fixes.get(fix_name(fixes[sample]))
        if planned is not None:
            out[k] = planned.added_G
    return out


def plan_of(
    decisions: Decisions,
    fixes: Sequence[Fix],
    track: tuple[Ints, Array],
    pings: int,
    depths: int,
) -> Plan:
    """Plan of the next pass: decisions, and the track (stamps, states) that it is held to.

    ``pings`` and ``depths`` are the numbers of samples.
    """
    judged = decisions.judged
    code = np.where(decisions.fused, rings.TO_FUSE, rings.TO_REFUSE)
    local = {
        rank: np.full(n, rings.BY_GATE) for rank, n in ((Rank.DVL, pings), (Rank.DEPTH, depths))
    }
    for rank, imposed in local.items():
        of = judged.ranks == rank
        imposed[judged.samples[of]] = code[of]
    planned: dict[FixName, FixPlan] = {}
    plain = {fused: FixPlan(fused, np.zeros((3, 3))) for fused in (False, True)}
    added = np.asarray(decisions.added_G.any(axis=(1, 2)))
    for k, place in enumerate(judged.of_fixes.tolist()):
        name, one = fix_name(fixes[judged.samples[place]]), plain[bool(decisions.fused[place])]
        planned[name] = one._replace(added_G=decisions.added_G[k]) if added[k] else one
    return Plan(*track, dvl=local[Rank.DVL], depth=local[Rank.DEPTH], fixes=planned)


@dataclass(frozen=True)
class Revision:
    """Measurement of which hindsight decided otherwise than the filter.

    Attributes
    ----------
    stamp_ns : int
        Of the measurement; of a fix its validity.
    topic : str
    before, after : Verdict
    nis, gate : float
        Of its residual to the track by all others.
    number : int
        In its stream; of a fix that of its source.
    """

    stamp_ns: int
    topic: str
    before: Verdict
    after: Verdict
    nis: float
    gate: float
    number: int

    def to_dict(self) -> dict[str, object]:
        """Values for JSON."""
        return {
            'stamp_ns': self.stamp_ns,
            'topic': self.topic,
            'number': self.number,
            'from': self.before.name,
            'to': self.after.name,
            'nis': self.nis,
            'gate': self.gate,
        }


_TOPICS = {Rank.DVL: 'dvl/data', Rank.DEPTH: 'depth/data'}


def revisions_of(
    first: Judged,
    last: Decisions,
    fixes: tuple[Sequence[Fix], Sequence[Fix]],
    stamps_ns: Mapping[Rank, Ints],
    gate_probability: float,
    receipts: Sequence[Receipt],
) -> tuple[tuple[Revision, ...], tuple[Receipt, ...]]:
    """Revisions between the first pass and the last, and the receipts of those of fixes.

    Parameters
    ----------
    first : Judged
        Of the filter.
    last : Decisions
        Judgement of the last pass about its own measurements.
    fixes : two sequences of Fix
        By numbers, of the first pass and of the last.
    stamps_ns : mapping of Rank to array
        Of usable pings and depths.
    gate_probability : float
    receipts : sequence of Receipt
        Of the first pass.
    """
    judged, out, revised = last.judged, [], []
    for k in _changed(first, judged, stamps_ns):
        rank, sample = Rank(int(judged.ranks[k])), int(judged.samples[k])
        gate = chi2_gate(gate_probability, int(judged.dof[k]))
        stamp_ns, nis = int(stamps_ns[rank][sample]), float(last.nis[k])
        now = bool(judged.fused[k])
        out.append(Revision(stamp_ns, _TOPICS[rank], *_verdicts(now), nis, gate, sample))
    was = {
        fix_name(fixes[0][first.samples[k]]): bool(first.fused[k]) for k in first.of_fixes.tolist()
    }
    changed = [
        (row, int(k), fix)
        for row, k in enumerate(judged.of_fixes)
        if was.get(fix_name(fix := fixes[1][judged.samples[k]]), False) != judged.fused[k]
    ]
    decided = _first_decided(receipts, {_name_in_receipts(fix) for _, _, fix in changed})
    for row, k, fix in changed:
        gate = chi2_gate(gate_probability, int(judged.dof[k]))
        before, after = _verdicts(bool(judged.fused[k]))
        receipt = decided.get(_name_in_receipts(fix))
        if receipt is not None:
            before = receipt.verdict
            revised.append(_revised(receipt, judged, row, float(last.nis[k]), gate, after))
        nis = float(last.nis[k])
        out.append(Revision(fix.validity_ns, fix.topic, before, after, nis, gate, fix.sequence))
    return tuple(out), tuple(revised)


def _changed(first: Judged, last: Judged, stamps_ns: Mapping[Rank, Ints]) -> list[int]:
    """Places in ``last`` of pings and depths of which ``first`` has another verdict."""
    out: list[int] = []
    for rank, stamps in stamps_ns.items():
        was = np.zeros(len(stamps), dtype=bool)
        was[first.samples[first.ranks == rank]] = first.fused[first.ranks == rank]
        at = np.flatnonzero(last.ranks == rank)
        out += at[last.fused[at] != was[last.samples[at]]].tolist()
    return out


def _verdicts(now: bool) -> tuple[Verdict, Verdict]:
    """Verdicts before and after of a measurement that is fused now, or not."""
    return (Verdict.GATED, Verdict.FUSED) if now else (Verdict.FUSED, Verdict.GATED)


_DECIDED = (Verdict.FUSED, Verdict.GATED, Verdict.IMPLAUSIBLE)


_Name = tuple[str, str, int, int]


def _name_in_receipts(x: Fix | Receipt) -> _Name:
    return (x.topic, x.source, x.sequence, x.validity_ns)


def _first_decided(receipts: Sequence[Receipt], names: Container[_Name]) -> dict[_Name, Receipt]:
    """First receipt of each of these fixes that says what a filter decided."""
    found: dict[_Name, Receipt] = {}
    for receipt in receipts:
        if receipt.verdict in _DECIDED and (name := _name_in_receipts(receipt)) in names:
            found.setdefault(name, receipt)
    return found


def _revised(
    receipt: Receipt, judged: Judged, row: int, nis: float, gate: float, after: Verdict
) -> Receipt:
    """Receipt of a fix with what hindsight decided."""
    side = 'below' if nis <= gate else 'above'
    return replace(
        receipt,
        verdict=after,
        reason=f'with hindsight: NIS {nis:.1f} against the track without it, {side} the gate of '
        f'{gate:.1f}',
        revision=receipt.revision + 1,
        fused_ns=receipt.validity_ns if after is Verdict.FUSED else 0,
        innovation_G=-judged.residuals[row],
        innovation_variance_G=np.diagonal(judged.covariances[row]).copy(),
        nis=nis,
        dof=int(judged.dof[judged.of_fixes[row]]),
        gate=gate,
    )
