"""Copies of a simulated world with changed sensor streams, the parts of faults.

A world is never changed; each function returns another one that shares the unchanged streams.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.inputs import Stamps
from polar_nav_core.grid import ecef_to_grid
from polar_nav_sim.randomness import stream
from polar_nav_sim.trajectory import TruthState

from ..world import World

_BLOCK = 50_000


def seconds(world: World, stamps: Stamps) -> Array:
    """Time since the start of the mission [s], shape (n,)."""
    return np.asarray((stamps - world.truth.start_ns) * 1e-9)


def drawn(world: World, name: str) -> np.random.Generator:
    """Random stream of a fault: of the world's seed, no other stream's."""
    return stream(world.seed, f'mismatch/{name}')


def attitude_at(world: World, stamps: Stamps) -> Array:
    """True body to grid at stamps, shape (n, 3, 3)."""
    parts = [
        world.truth.state(stamps[i : i + _BLOCK]).C_b_G for i in range(0, len(stamps), _BLOCK)
    ]
    return np.concatenate(parts)


def to_body(C_b_G: Array, x_G: Array) -> Array:
    """Vectors (n, 3) of grid axes in body axes."""
    return np.asarray(np.einsum('nji,nj->ni', C_b_G, x_G))


def add_imu(world: World, d_omega_b: Array | float = 0.0, d_f_b: Array | float = 0.0) -> World:
    """World with errors added to rate [rad/s] and specific force [m/s^2], each (n, 3) or 0."""
    i = world.inputs
    changed = replace(i, omega_ib_b=i.omega_ib_b + d_omega_b, f_b=i.f_b + d_f_b)
    return replace(world, inputs=changed)


def add_dvl(world: World, d_v_m: Array) -> World:
    """World with errors (d, 3) added to the pings [m/s]."""
    i = world.inputs
    return replace(world, inputs=replace(i, dvl_v_m=i.dvl_v_m + d_v_m))


def add_depth(world: World, d_depth: Array | float) -> World:
    """World with errors (e,) added to the depths [m]."""
    i = world.inputs
    return replace(world, inputs=replace(i, depth=i.depth + d_depth))


def truth_of_fixes(world: World) -> TruthState:
    """True states at the validity of the world's fixes, in their order."""
    return world.truth.state(validities(world))


def validities(world: World) -> NDArray[np.int64]:
    """Validity of the fixes [ns], shape (k,)."""
    return np.array([f.validity_ns for f in world.inputs.fixes], dtype=np.int64)


def see_fixes_along(world: World, line_G: Array) -> World:
    """World whose fixes state the vector from the leader's array, (k, 3) in true grid axes [m]."""
    relative_e = np.einsum('nji,nj->ni', truth_of_fixes(world).C_e_G, line_G)
    fixes = zip(world.inputs.fixes, relative_e, strict=True)
    return world.with_fixes(tuple(replace(f, relative_e=r_e) for f, r_e in fixes))


def move_fixes(world: World, d_r_G: Array, variance_G: Array | None = None) -> World:
    """World with fixes moved by (k, 3) metres in the grid axes of their true positions.

    ``variance_G``, (k, 3, 3), is added to their stated covariance.
    """
    C_e_G = truth_of_fixes(world).C_e_G
    d_r_e = np.einsum('nji,nj->ni', C_e_G, d_r_G)
    added_e = np.zeros((len(d_r_e), 3, 3))
    if variance_G is not None:
        added_e = np.einsum('nji,njk,nkl->nil', C_e_G, variance_G, C_e_G)
    return world.with_fixes(
        tuple(
            replace(f, r_e=f.r_e + d, covariance_e=f.covariance_e + v)
            for f, d, v in zip(world.inputs.fixes, d_r_e, added_e, strict=True)
        )
    )


def restamp_fixes(world: World, shift_ns: Sequence[int]) -> World:
    """World with stated times of validity shifted by (k,) [ns], never beyond reception."""
    return world.with_fixes(
        tuple(
            replace(f, validity_ns=min(f.validity_ns + shift, f.receive_ns))
            for f, shift in zip(world.inputs.fixes, shift_ns, strict=True)
        )
    )


def keep_fixes(world: World, keep: Callable[[Fix], bool]) -> World:
    """World without some fixes."""
    return world.with_fixes(tuple(f for f in world.inputs.fixes if keep(f)))


def from_start_G(world: World, r_e: Array) -> Array:
    """Positions (k, 3) relative to the true start, in the grid axes there [m]."""
    first = world.truth.state(world.truth.start_ns)
    return np.asarray((r_e - first.r_e) @ np.asarray(ecef_to_grid(first.r_e)).T)


def abeam_G(world: World) -> Array:
    """Horizontal unit vector to port of the first course, grid axes, shape (3,)."""
    v_G = world.truth.state(int(world.inputs.imu_stamps_ns[0])).v_G
    return np.asarray(np.array([-v_G[1], v_G[0], 0.0]) / np.hypot(v_G[0], v_G[1]))
