"""Compiles every kernel that a node or a replay runs into the cache.

``python -m polar_nav_core.kernels.warm`` is part of the set-up: a cold compile takes long, and a
live node would fall behind its sensors meanwhile.
"""

from __future__ import annotations

import numpy as np

from .. import earth, strapdown
from . import filter as kf
from . import filter_clone as kc
from . import filter_imu, filter_rows, filter_walk


def warm_filter() -> None:
    """Call every kernel of the filter with arguments of the types that the filter uses."""
    v = np.zeros(3)
    eye = np.eye(3)
    r_e = np.ascontiguousarray(earth.ecef_from_geodetic(1.4, 0.3, -50.0), dtype=np.float64)
    w = kf.scratch()
    H, R, z, x = np.zeros((3, kf.N)), np.eye(3), np.zeros(3), np.zeros(kf.N)
    P, Phis = np.eye(kf.N), np.stack([np.eye(kf.N)] * 2)
    sums, increments = np.zeros((6, 3)), np.zeros((4, 3))
    C, u, f_b = np.eye(3), np.zeros(3), np.array([0.0, 0.0, 9.8])
    filter_imu.imu_step(C, v.copy(), r_e, v, v, u, f_b, increments, 0.01, 0.01, sums)
    filter_imu.take_means(sums, np.zeros((3, 3)), np.zeros(3), np.zeros(3))
    frames = [np.zeros((3, 3)), *(np.zeros(3) for _ in range(5))]
    filter_imu.place(r_e, v, C, v, *frames)
    kf.fill_transition(Phis[0], w['F15'], r_e, v, eye, u, f_b, 0.1, 300.0, 0.0)
    kf.predict(P, Phis[0], x, w['M'])
    kf.cholesky(w['LP'], P, kf.N)
    filter_rows.dvl_rows(H, R, z, np.zeros((3, 3)), C, v, u, v, v, v, v, v, eye, eye, v)
    filter_rows.depth_rows(H, R, z, eye, C, -50.0, -50.0, 0.01, v)
    filter_rows.fix_rows(H, R, z, eye, v, r_e, r_e, eye, np.zeros((3, 3)), v)
    steps = np.zeros(4, dtype=np.int64)
    filter_walk.walk_forward(
        H, z, 3, Phis, 0, 1, np.zeros((4, kf.N)), steps, 0, 1, w['LU'], w['pivot']
    )
    kf.innovation_covariance(w['S'], w['PHt'], P, H, R, 3)
    kf.cholesky(w['L'], w['S'], 3)
    kf.nis_of(w['L'], z, w['w'], 3)
    kf.update(P, x, H, R, z, 3, w['K'], w['PHt'], w['L'], w['M'])
    cross, P_cc, work = np.zeros((kf.N, 3)), np.eye(3), np.zeros((6, 3))
    kc.clone_begin(cross, P_cc, P, H)
    kc.clone_step(cross, Phis[0], np.zeros((kf.NAV, 3)))
    kc.clone_measurement(cross, P_cc, z, H, w['L'], w['K'], z, 3, work)
    kc.clone_fuse(P, x, cross, P_cc, R, w['L'], z, w['K'], w['M'])
    kc.drop_information(P, w['K'], w['S'], 3)
    kf.feed_back(x, C, v.copy(), r_e.copy(), *(np.zeros(3) for _ in range(5)))


def warm_up() -> None:
    """Compile or load every kernel that a node or a replay runs."""
    strapdown.warm_up()
    warm_filter()


if __name__ == '__main__':
    warm_up()
