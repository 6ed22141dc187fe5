"""Scratch of the compiled filter: what a step or a measurement needs while it is processed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array, Ints
from . import consider, hypotheses
from .model import E
from .update import COUPLED, N

MODEL_WORK = 63
"""Rows of Work.model."""


class Work(NamedTuple):
    """Scratch; H, R, z, x, K, S and nis hold the last update."""

    F15: Array
    M: Array
    LP: Array
    L: Array
    S: Array
    PHt: Array
    K: Array
    w: Array
    H: Array
    R: Array
    stated: Array
    z: Array
    x: Array
    q: Array
    decays: Array  # (3,): a time step [s], what of `Settings.markov` and `usbl` it adds
    share: Array  # (2,): an interval [s], the share of it in swing.follow
    J: Array  # (3, COLUMNS): innovation per unit of each common error, by itself
    moved: Array  # (3, COLUMNS): the same, with what the estimate has taken of it
    wide: Array  # (3, 3): S with the common errors
    wide_L: Array  # its factor
    per_sigma: Array  # (3, COLUMNS): moved, per sigma of each common error
    learned: Array  # (3, COLUMNS): scratch of shared.learn
    residual: Array  # (3,): innovation less what is known of the common errors
    narrow: Array  # (3, 3): its covariance
    narrow_L: Array  # its factor
    D: Array  # (3, 24): G - K S/2 of the last update, transposed
    nis: Array  # (2,): NIS, and by how much S was enlarged after the gate
    age: Array  # (1,): of the fix in H, R, z [s]
    dof: Ints  # (1,): degrees of freedom of that fix, as it was stated (engine.level)
    signatures: Array  # (SCRATCH, SLOTS * KINDS): scratch of signatures
    powers: Array  # (9, 3): scratch of the same
    evidence: Array  # (3,): scratch of the same
    C_m_G: Array
    C_mean: Array
    C_a_G: Array
    C_e_G: Array  # (3, 3): grid frame at another place than that of Frames
    f_mean: Array
    omega_mean: Array
    omega: Array
    f: Array
    owed: Array  # (2, 3): angle and velocity that a sample has to make up for (fill)
    line: Array  # (4,): of the course between two samples (fill.begin_sample)
    bend: Array  # (2, 3): second derivative of rate and force on it
    acceleration: Array  # (3,): in body axes
    point_e: Array
    velocity_e: Array
    model: Array  # (MODEL_WORK, 7) of the vehicle's model, rows as in aiding
    model_slopes: Array  # (6, 24): F_ex and Phi_ex of the vehicle's model


def make_work() -> Work:
    """Return scratch arrays."""

    def three() -> Array:
        return np.zeros(3)

    def square() -> Array:
        return np.zeros((3, 3))

    rows = (3, N)
    return Work(
        F15=np.zeros((COUPLED, COUPLED)),
        M=np.zeros((N, N)),
        LP=np.zeros((N, N)),
        L=square(),
        S=square(),
        PHt=np.zeros(rows),
        K=np.zeros(rows),
        w=three(),
        H=np.zeros(rows),
        R=square(),
        stated=square(),
        z=three(),
        x=np.zeros(N),
        q=np.zeros(N),
        decays=np.zeros(3),
        share=np.zeros(2),
        J=np.zeros((3, consider.COLUMNS)),
        moved=np.zeros((3, consider.COLUMNS)),
        wide=square(),
        wide_L=square(),
        per_sigma=np.zeros((3, consider.COLUMNS)),
        learned=np.zeros((3, consider.COLUMNS)),
        residual=three(),
        narrow=square(),
        narrow_L=square(),
        D=np.zeros(rows),
        nis=np.array([0.0, 1.0]),
        age=np.zeros(1),
        dof=np.full(1, 3, dtype=np.int64),
        signatures=np.zeros((hypotheses.SCRATCH, hypotheses.SLOTS * hypotheses.KINDS)),
        powers=np.zeros((9, 3)),
        evidence=three(),
        C_m_G=square(),
        C_mean=square(),
        C_a_G=square(),
        C_e_G=square(),
        f_mean=three(),
        omega_mean=three(),
        acceleration=three(),
        omega=three(),
        f=three(),
        owed=np.zeros((2, 3)),
        line=np.zeros(4),
        bend=np.zeros((2, 3)),
        point_e=three(),
        velocity_e=three(),
        model=np.zeros((MODEL_WORK, E)),
        model_slopes=np.zeros((6, N)),
    )
