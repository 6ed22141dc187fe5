"""Backward pass over the nodes of a bank: smoothed states, their mixture, residuals of the fixes.

Equations: docs/derivations/smoother.md, of each member; its weight at a node is that of all fixes,
before and after.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields

import numpy as np

from ..arrays import Array
from ..errors import ConfigError
from ..kernels.station import run
from ..kernels.station import state as ss
from .events import Rank
from .hindsight import Judged
from .station import arrays
from .station.filter import StationFilter
from .station.recorded import Tape
from .track import StationTrack

_ROWS = 512
_PUBLISHED = [*range(ss.POSITION, ss.CURRENT), ss.HEADING]
_WEIGHS = 1e-3
"""A member of less weight moves nothing."""


@dataclass(frozen=True)
class Back:
    """Result of a backward pass.

    Attributes
    ----------
    track : StationTrack
        Of the nodes that are put out.
    states : dict of int to (B, 12) array
        Smoothed states of the members by the stamps of all nodes [ns].
    judged : Judged
        The fixes, along x and y of the station's frame.
    outcomes : (fixes, OUTCOME) array
        Their rows of outcomes.
    moved : float
        Largest movement against the track that the filter was held to, in sigmas.
    parts : int
        Filters one after the other: more than one where one was lost.
    """

    track: StationTrack
    states: dict[int, Array]
    judged: Judged
    outcomes: Array
    moved: float
    parts: int


class Adjoint:
    """What all later measurements say of the errors of the members.

    Attributes
    ----------
    vector : (B, 12, 1 + COMMON) array
        lambda, and its change per unit of each common error.
    information : (B, 12, 12) array
        Lambda.
    log_weight : (B,) array
        Log-likelihoods of the later fixes, the farther ones forgotten as in the filter.
    """

    def __init__(self, members: int, forgetting: float) -> None:
        self._forgetting = forgetting
        self.vector = np.zeros((members, ss.N, 1 + ss.COMMON))
        self.information = np.zeros((members, ss.N, ss.N))
        self.log_weight = np.zeros(members)

    def clear(self) -> None:
        """Forget everything: a filter ended here."""
        self.vector[:], self.information[:], self.log_weight[:] = 0.0, 0.0, 0.0

    def before_fix(self, node: np.ndarray) -> None:
        """Go to before the fix of a node, which was fused."""
        H, K, S = node['H'], node['K'], node['S_z']
        keep = np.eye(ss.N) - np.einsum('mia,maj->mij', K, H)
        z = np.concatenate([node['z'][:, :, None], node['J']], axis=2)
        Y = np.linalg.solve(S, np.concatenate([z, H], axis=2))
        own, rows = Y[:, :, : z.shape[2]], Y[:, :, z.shape[2] :]
        self.vector = _turned(keep, self.vector) - np.einsum('mai,mak->mik', H, own)
        self.information = _around(keep, self.information) + np.einsum('mai,maj->mij', H, rows)
        square = np.einsum('ma,ma->m', node['z'], own[:, :, 0])
        likelihood = -0.5 * (square + np.log(np.linalg.det(S)))
        self.log_weight = self._forgetting * self.log_weight + likelihood
        self.log_weight -= self.log_weight.max()

    def before_way(self, node: np.ndarray) -> None:
        """Go to the node before, after its fix."""
        Psi = node['Psi']
        self.vector = _turned(Psi, self.vector) - node['vector']
        self.information = _around(Psi, self.information) + node['information']


def _turned(A: Array, V: Array) -> Array:
    """A^T V of each member."""
    return np.asarray(np.einsum('mji,mjk->mik', A, V))


def _around(A: Array, M: Array) -> Array:
    """A^T M A of each member, symmetric."""
    X = np.einsum('mij,mjk->mik', _turned(A, M), A)
    return np.asarray(0.5 * (X + np.swapaxes(X, 1, 2)))


class _Rows:
    """Smoothed estimates, as the filter would put them out, from the last to the first."""

    def __init__(self, f: StationFilter) -> None:
        self._f = f
        self._bank = arrays.make_bank(len(f.bank.x))
        self._rows = arrays.make_rows(_ROWS, len(f.bank.x))
        self._pieces: list[StationTrack] = []

    def put(self, node: np.ndarray, x: Array, P: Array, S: Array, weight: Array) -> None:
        """Put out the mixture of smoothed members at a node."""
        b = self._bank
        b.x[:], b.P[:], b.S[:], b.weight[:] = x, P, S, weight
        b.flat[:], b.loose[:], b.counters[:] = node['flat'], node['loose'], node['counters']
        run.put_row(b, self._f.settings, self._f.work, self._f.streams, self._rows)
        if self._rows.io[1] == _ROWS:
            self._drain()

    def _drain(self) -> None:
        n, rows = int(self._rows.io[1]), self._rows
        newest_first = slice(n - 1, None, -1) if n else slice(0, 0)
        self._pieces.append(
            StationTrack(
                stamps_ns=rows.stamps[newest_first].copy(),
                r_e=rows.r_e[newest_first].copy(),
                v_G=rows.v_G[newest_first].copy(),
                C_b_G=rows.C_b_G[newest_first].copy(),
                P=rows.P[newest_first].copy(),
                x=rows.x[newest_first].copy(),
                P_x=rows.P_x[newest_first].copy(),
                walk=rows.walk[newest_first].copy(),
                weight=rows.weight[newest_first].copy(),
                local_statistics=np.zeros((n, 2, 3)),
                fixes=np.zeros((n, 3), dtype=np.int64),
            )
        )
        rows.io[1] = 0

    def track(self) -> StationTrack:
        """The track in the order of time."""
        self._drain()
        self._pieces.reverse()
        names = [f.name for f in fields(StationTrack)]
        track = StationTrack(
            **{n: np.concatenate([getattr(p, n) for p in self._pieces]) for n in names}
        )
        if not len(track.stamps_ns):
            raise ConfigError('there is nothing to smooth: the filter did not start')
        return track


@dataclass
class Residuals:
    """Residuals of fixes, from the last to the first, with their rows of outcomes."""

    numbers: list[int] = field(default_factory=list)
    fused: list[bool] = field(default_factory=list)
    e: list[Array] = field(default_factory=list)
    V: list[Array] = field(default_factory=list)
    S: list[Array] = field(default_factory=list)
    outcomes: list[Array] = field(default_factory=list)

    def judged(self) -> Judged:
        """The fixes in the order of their numbers."""
        order = np.argsort(np.array(self.numbers, dtype=np.int64))
        n = len(order)
        e, V, S = np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.tile(np.eye(3), (n, 1, 1))
        if n:
            e[:, :2] = np.array(self.e)[order]
            V[:, :2, :2] = np.array(self.V)[order]
            S[:, :2, :2] = np.array(self.S)[order]
        sizes = np.full(n, 2, dtype=np.int64)
        fused = np.array(self.fused, dtype=bool)[order]
        return Judged(
            ranks=np.full(n, int(Rank.FIX), dtype=np.int64),
            samples=np.array(self.numbers, dtype=np.int64)[order],
            sizes=sizes,
            dof=sizes,
            fused=fused,
            nis=np.full(n, math.nan),
            residuals=e,
            covariances=V,
            S=S,
        )

    def rows(self) -> Array:
        """Rows of outcomes (n, OUTCOME) in the same order."""
        order = np.argsort(np.array(self.numbers, dtype=np.int64))
        return np.array(self.outcomes).reshape(-1, ss.OUTCOME)[order]


def backwards(tape: Tape, progress: Callable[[float], None] | None = None) -> Back:
    """Smoothed states of a recorded run.

    Raises
    ------
    ConfigError
        When no filter started.
    """
    f = tape.filter
    if f is None:
        raise ConfigError('there is nothing to smooth: the filter did not start')
    members = len(f.bank.x)
    adjoint = Adjoint(members, float(f.settings.forgetting))
    rows = _Rows(f)
    residuals = Residuals()
    states: dict[int, Array] = {}
    moved, parts, total = 0.0, 0, len(tape.nodes)
    for number, node in enumerate(tape.nodes.backwards()):
        if node['fix'] >= 0:
            judge(residuals, node, adjoint, f)
            if node['fused']:
                adjoint.before_fix(node)
        P = node['P']
        PL = np.einsum('mij,mjk->mik', P, adjoint.vector)
        x = node['x'] - PL[:, :, 0]
        P_s = P - np.einsum('mij,mjk->mik', P, np.einsum('mij,mjk->mik', adjoint.information, P))
        weight = _weights(node, adjoint)
        if tape.plan is not None:
            before = tape.plan.states.get(int(node['stamp']))
            if before is not None:
                moved = max(moved, _movement(x - before, P_s, weight))
        states[int(node['stamp'])] = x
        if node['shown']:
            rows.put(node, x, P_s, node['S'] - PL[:, :, 1:], weight)
        if node['begins']:
            parts += 1
            adjoint.clear()
        else:
            adjoint.before_way(node)
        if progress is not None and number % _ROWS == 0:
            progress(number / total)
    return Back(rows.track(), states, residuals.judged(), residuals.rows(), moved, parts)


def _weights(node: np.ndarray, adjoint: Adjoint) -> Array:
    """Weights (B,) of the members by all fixes, before and after."""
    together = node['log_weight'] + adjoint.log_weight
    weight = np.exp(together - together.max())
    return np.asarray(weight / weight.sum())


def _movement(d: Array, P: Array, weight: Array) -> float:
    """Largest change of position or heading of the members that count, in its sigmas.

    Drag and the velocity through the water may move as they like where the model does not hold.
    """
    d, variance = d[:, _PUBLISHED], np.einsum('mii->mi', P)[:, _PUBLISHED]
    with np.errstate(all='ignore'):
        sigmas = np.where(variance > 0.0, np.abs(d) / np.sqrt(variance), 0.0)
    return float(sigmas[weight > _WEIGHS].max(initial=0.0))


def judge(out: Residuals, node: np.ndarray, adjoint: Adjoint, f: StationFilter) -> None:
    """Add the residual of a fix to the track that all other measurements give."""
    S, K = node['S_z'], node['K']
    back = np.einsum('mia,mik->mak', K, adjoint.vector)
    A = np.einsum('mia,mij,mjb->mab', K, adjoint.information, K)
    z = np.concatenate([node['z'][:, :, None], node['J']], axis=2)
    u = np.linalg.solve(S, z) + back
    if node['fused']:
        V = np.linalg.inv(np.linalg.inv(S) + A)
        e = np.einsum('mab,mbk->mak', V, u)
    else:
        e = np.einsum('mab,mbk->mak', S, u)
        V = S - np.einsum('mab,mbc,mcd->mad', S, A, S)
    V = V - (1.0 - 1.0 / node['inflation'])[:, None, None] * S  # the stated noise alone
    weight = _weights(node, adjoint)
    mean = np.einsum('m,mak->ak', weight, e)
    off = e[:, :, 0] - mean[:, 0]
    V_all = np.einsum('m,mab->ab', weight, V) + np.einsum('m,ma,mb->ab', weight, off, off)
    shared = mean[:, 1:] * f.settings.common
    V_all = V_all + np.einsum('ak,bk->ab', shared, shared)
    S_all = np.einsum('m,mab->ab', weight, S / node['inflation'][:, None, None])
    c, s = math.cos(node['outcome'][ss.AZIMUTH]), math.sin(node['outcome'][ss.AZIMUTH])
    distance = float(node['outcome'][ss.DISTANCE])
    to_xy = np.array([[c, -distance * s], [s, distance * c]])
    out.numbers.append(int(node['fix']))
    out.fused.append(bool(node['fused']))
    out.e.append(-to_xy @ mean[:, 0])
    out.V.append(to_xy @ V_all @ to_xy.T)
    out.S.append(to_xy @ S_all @ to_xy.T)
    out.outcomes.append(node['outcome'].copy())
