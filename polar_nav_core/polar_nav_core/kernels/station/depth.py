"""Depth in station mode: its row along the vertical, gate of the bank, update.

Equations: docs/derivations/station.md.
"""

from __future__ import annotations

from ...arrays import Array
from .. import watch
from ..cache import routine
from . import state as ss
from .state import Bank, Settings, Streams, Tape, Work
from .step import lever_arm
from .tape import tape_depth

X, Y, Z = ss.POSITION, ss.POSITION + 1, ss.POSITION + 2


@routine
def depth_event(b: Bank, c: Settings, w: Work, streams: Streams, jumps: Array, tape: Tape) -> None:
    """Fuse the next depth: height = surface - depth, along the vertical at the vehicle.

    The gate is of the whole bank: mean innovation, spread of the members and common errors
    included.
    """
    i = b.counters[ss.DEPTH]
    k = i % streams.depth_stamps.shape[0]
    b.counters[ss.DEPTH] = i + 1
    lever_arm(b, w, streams, b.counters[ss.IMU] - 1, c.lever_depth_b)
    u_x = b.flat[ss.UP]
    u_y = b.flat[ss.UP + 1]
    u_z = b.flat[ss.UP + 2]
    known = c.surface - streams.depth[k] - b.flat[ss.HEIGHT]
    for j in range(3):
        known += b.flat[ss.UP + j] * (b.flat[ss.PLACE + j] - w.lever[j])
    mean = 0.0
    members = b.x.shape[0]
    for m in range(members):
        P = b.P[m]
        x = b.x[m]
        for j in range(ss.N):
            w.PHt[m, 0, j] = u_x * P[X, j] + u_y * P[Y, j] + u_z * P[Z, j]
        h = w.PHt[m, 0]
        w.S[m, 0] = u_x * h[X] + u_y * h[Y] + u_z * h[Z] + streams.depth_variance[k]
        w.z[m, 0] = known - (u_x * x[X] + u_y * x[Y] + u_z * x[Z])
        w.wide[m, 0] = w.S[m, 0]
        if c.shares:
            J = w.J[m, 0]
            for j in range(ss.COMMON):
                J[j] = -(u_x * b.S[m, X, j] + u_y * b.S[m, Y, j] + u_z * b.S[m, Z, j])
            J[ss.DEPTH_ZERO] -= 1.0
            for j in range(ss.COMMON):
                w.wide[m, 0] += J[j] * J[j] * c.common[j] * c.common[j]
        mean += b.weight[m] * w.z[m, 0]
    S = 0.0
    for m in range(members):
        off = w.z[m, 0] - mean
        S += b.weight[m] * (w.wide[m, 0] + off * off)
    nis = mean * mean / S
    w.nis[0] = nis
    w.nis[1] = mean
    w.nis[2] = S
    w.nis[3] = 0.0
    w.z3[0] = -mean
    w.S3[0, 0] = S
    if nis >= 0.0 and S > 0.0:
        passed = nis <= c.gates[1]
        memories = b.memories[ss.DEPTH_ROW]
        watch.observe(memories, w.z3, w.S3, nis, 1, passed, 0.0, 0.0, w.z3, w.S3)
    if not nis <= c.gates[1]:
        if b.counting[0]:
            b.tally[ss.DEPTH_ROW, ss.GATED] += 1.0
        return
    w.nis[3] = 1.0
    if b.counting[0]:
        b.tally[ss.DEPTH_ROW, ss.UPDATES] += 1.0
        b.tally[ss.DEPTH_ROW, ss.NIS_SUM] += nis
    for m in range(members):
        h = w.PHt[m, 0]
        gain = w.z[m, 0] / w.S[m, 0]
        weight = 1.0 / w.S[m, 0]
        P = b.P[m]
        for i in range(ss.N):
            b.x[m, i] += gain * h[i]
            if jumps.shape[0] > 0:
                jumps[(b.counters[ss.IMU] - 1) % jumps.shape[0], m, i] += gain * h[i]
            scaled = weight * h[i]
            for j in range(i + 1):
                P[i, j] -= scaled * h[j]
                P[j, i] = P[i, j]
        if c.shares:
            for i in range(ss.N):
                for j in range(ss.COMMON):
                    b.S[m, i, j] += weight * h[i] * w.J[m, 0, j]
        tape_depth(tape, m, b.flat[ss.UP : ss.UP + 3], w, c.shares)
