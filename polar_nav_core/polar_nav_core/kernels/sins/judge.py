"""Whether a measurement is believed, and with what noise: adapted noise, NIS, gate, weights.

Whole runs, clones and fixes that are fused again share these. Derivation of the adapted noise:
docs/derivations/adaptation.md.
"""

from __future__ import annotations

import math

from ...arrays import Array
from .. import watch
from ..cache import entry, kernel
from ..watch import observe
from . import state as fs
from .bend import add_bend_of_ping
from .consider import innovation_sensitivity, widen
from .reopen import FEWEST, agrees
from .settings import Settings
from .shared import forget, learn, residual, whitened
from .state import State
from .update import cholesky, innovation_covariance, nis_of
from .work import Work


@kernel
def scale_noise(R: Array, noise: Array, c: Settings) -> None:
    """R <- D R D, D^2 the adapted ratio per axis (columns 1..3 of ``noise``), within bounds."""
    for a in range(3):
        row = math.sqrt(min(max(noise[1 + a], c.floor), c.ceiling))
        for b in range(3):
            R[a, b] *= row * math.sqrt(min(max(noise[1 + b], c.floor), c.ceiling))


@kernel
def learn_noise(noise: Array, z: Array, stated: Array, b: float, enlargement: float) -> None:
    """Fading average of z^2 / stated variance per axis; ``noise[0]`` is b^k."""
    noise[0] *= b
    d = (1.0 - b) / (1.0 - noise[0])
    for a in range(3):
        noise[1 + a] = (1.0 - d) * noise[1 + a] + d * z[a] * z[a] / (enlargement * stated[a, a])


@kernel
def judge_rows(w: Work, P: Array, H: Array, R: Array, z: Array, m: int) -> bool:
    """Whether S is positive definite; PHt, S, its factor and NIS are in the scratch."""
    innovation_covariance(w.S, w.PHt, P, H, R, m)
    if not cholesky(w.L, w.S, m):
        return False
    w.nis[0] = nis_of(w.L, z, w.w, m)
    return True


@entry
@kernel
def judge(s: State, c: Settings, w: Work, R: Array, m: int) -> bool:
    """Whether S is positive definite; PHt, S, its factor and NIS are in the scratch.

    NIS is that of S with the common errors.
    """
    if not judge_rows(w, s.P, w.H, R, w.z, m):
        return False
    if s.counters[fs.CONSIDERS] == 1:
        for a in range(m):
            for k in range(w.J.shape[1]):
                w.moved[a, k] = w.J[a, k]
        innovation_sensitivity(w.moved, w.H, s.sensitivity, m)
        return judge_wide(c, w, w.z, m)
    for a in range(m):
        for b in range(m):
            w.wide[a, b] = w.S[a, b]
    return True


@kernel
def judge_wide(c: Settings, w: Work, z: Array, m: int) -> bool:
    """Whether S with the common errors is positive definite; NIS is that of it.

    S stands in the scratch, and in ``moved`` what the innovation z does per common error.
    """
    widen(w.wide, w.S, w.moved, c.common, m)
    if not cholesky(w.wide_L, w.wide, m):
        return False
    w.nis[0] = nis_of(w.wide_L, z, w.w, m)
    return True


@entry
@kernel
def remember(s: State, c: Settings, w: Work, z: Array, stream: int, m: int, fused: bool) -> bool:
    """Add a judged measurement to the memories of its stream (watch); stores when it was used.

    What it shows of the common errors is learned from those that are used (shared). Returns
    whether its residual, which is in the scratch then, is evidence about slow faults (signatures).
    """
    if fused:
        s.counters[fs.USED_NS + stream] = s.counters[fs.STAMP]
        s.counters[fs.USES + stream] += 1
        s.counters[fs.REFUSED_ROW + stream] = 0
    else:
        s.counters[fs.REFUSED_ROW + stream] += 1
    memories = s.memories[stream]
    dof = dof_of(w, stream, m)
    v_x, v_y = s.v_G[0], s.v_G[1]
    if s.counters[fs.CONSIDERS] == 1:
        dt = (s.counters[fs.STAMP] - s.counters[fs.SHARED_NS]) * 1e-9
        if dt > 0.0 and s.counters[fs.SHARED_NS] > 0:
            forget(s.shared, dt)
        s.counters[fs.SHARED_NS] = s.counters[fs.STAMP]
        for a in range(m):
            for k in range(w.moved.shape[1]):
                w.per_sigma[a, k] = w.moved[a, k]
        residual(w.residual, w.narrow, s.shared, w.per_sigma, c.common, z, w.wide, w.learned, m)
        nis = whitened(w.narrow_L, w.narrow, w.residual, w.w, m)
        if nis >= 0.0:
            observe(memories, w.residual, w.narrow, nis, dof, fused, v_x, v_y, z, w.wide)
            if fused:
                learn(s.shared, w.per_sigma, w.narrow_L, w.w, w.learned, w.nis[1], m)
            return fused
    observe(memories, z, w.wide, w.nis[0], dof, fused, v_x, v_y, z, w.wide)
    return fused and s.counters[fs.CONSIDERS] == 0


@kernel
def adapt_noise(s: State, c: Settings, w: Work, stream: int, m: int) -> None:
    """Store R as stated, and scale it as the stream's noise is adapted; three rows only."""
    if c.adaptive and m == fs.VECTOR:
        for a in range(3):
            for b in range(3):
                w.stated[a, b] = w.R[a, b]
        scale_noise(w.R, s.noise[stream], c)


@kernel
def passes(s: State, c: Settings, w: Work, z: Array, stream: int, m: int) -> bool:
    """Whether a judged measurement passes the gate; if so, its weight and the adapted noise.

    Of a fix far off, R and S in the scratch are enlarged; ``nis[1]`` says by how much. ``z`` is
    the innovation that belongs to S.
    """
    w.nis[1] = 1.0
    dof = dof_of(w, stream, m)
    if not w.nis[0] <= c.gates[dof]:
        return False
    if stream == fs.FIX_ROW and w.nis[0] > c.far_nis and _is_out_of_reach(s, c, w, z, dof):
        return False
    if stream == fs.FIX_ROW:
        w.nis[1] = enlarge(w, c, dof)
    if c.adaptive and m == fs.VECTOR:
        learn_noise(s.noise[stream], z, w.stated, c.forgetting, w.nis[1])
    return True


@entry
@kernel
def dof_of(w: Work, stream: int, m: int) -> int:
    """Degrees of freedom of the measurement in the scratch: its m rows, of a fix as stated.

    What its noise became since does not count: an enlarged one measures the height, too.
    """
    return int(w.dof[0]) if stream == fs.FIX_ROW and m == fs.VECTOR else m


@kernel
def _is_out_of_reach(s: State, c: Settings, w: Work, z: Array, dof: int) -> bool:
    """Whether a fix lies farther off than the vehicle can have moved since one was used.

    By its first ``dof`` rows. Since the start, or since the gate was opened, where none was used
    after it.
    """
    used_ns = max(s.counters[fs.USED_NS + fs.FIX_ROW], s.counters[fs.OPENED_NS + fs.FIX_ROW])
    reach = c.max_speed * ((s.counters[fs.STAMP] - used_ns) * 1e-9 + w.age[0])
    square = z[0] * z[0] + z[1] * z[1]
    if dof > 2:
        square += z[2] * z[2]
    far: bool = square > reach * reach
    return far


@kernel
def is_definite_in_doubt(s: State, c: Settings, w: Work, stream: int, m: int) -> bool:
    """Enlarge the noise of a local sensor of which most is refused; whether S is definite then.

    What passes the gate does so by chance, at whatever phase of the error it comes, and its stated
    noise is not that of its stream: R <- R mean(NIS per row) of what came lately, refused or not.
    """
    row = s.memories[stream, watch.SHORT]
    weight = row[watch.WEIGHT]
    if weight < FEWEST or agrees(s, stream) or not row[watch.NIS] > weight:
        return True
    for a in range(m):
        for b in range(m):
            w.R[a, b] *= row[watch.NIS] / weight
    nis = w.nis[0]
    definite = judge(s, c, w, w.R, m)
    w.nis[0] = nis
    return definite


@kernel
def ping_passes(s: State, c: Settings, w: Work) -> int:
    """FUSED if the ping in H, R, z would pass the gate, REFUSED, or S_NOT_DEFINITE."""
    for a in range(3):
        for b in range(3):
            w.stated[a, b] = w.R[a, b]
    if c.gap_ns > 0:
        add_bend_of_ping(w.stated, s.P, s.v_G)
    if c.adaptive:
        scale_noise(w.stated, s.noise[fs.DVL_ROW], c)
    w.nis[1] = 1.0
    if not judge(s, c, w, w.stated, fs.VECTOR):
        return fs.S_NOT_DEFINITE
    return fs.FUSED if w.nis[0] <= c.gates[fs.VECTOR] else fs.REFUSED


@kernel
def enlarge(w: Work, c: Settings, dof: int) -> float:
    """Factor lambda >= 1 of a fix that passed the gate, by its NIS (engine.sins.robust).

    ``dof`` are the degrees of freedom of NIS.

    R <- R + (lambda - 1) S in the scratch; S and its factor follow.
    """
    if c.robust == fs.ROBUST_NONE or not w.nis[0] > c.robust_thresholds[dof]:
        return 1.0
    factor: float = w.nis[0] / c.robust_thresholds[dof]
    if c.robust == fs.ROBUST_HUBER:
        factor = math.sqrt(factor)
    root = math.sqrt(factor)
    for a in range(3):
        for b in range(3):
            w.R[a, b] += (factor - 1.0) * w.S[a, b]
            w.S[a, b] *= factor
            w.L[a, b] *= root
    return factor
