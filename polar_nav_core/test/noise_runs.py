"""Runs of the noise adaptations in the closed-loop world; as a script, the tables of the docs.

python polar_nav_core/test/noise_runs.py
"""

import dataclasses
import sys

import numpy as np
from closed_loop import World, run

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.outputs import Estimate

CONFIGURATIONS = ('conventional_akf_published', 'modified_akf_published')


def sensors(world, seed=1):
    """IMU, DVL and depth with the stated noise."""
    rng = np.random.default_rng(seed)
    return [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng)]


@dataclasses.dataclass
class Measured:
    """How one run went: largest errors while estimates came [m], [deg], when they ended [s]."""

    engine: Engine
    out: list
    position: float
    attitude_deg: float
    last_s: float
    errors: np.ndarray


def measure(world, params, fixes):
    """Run an engine and compare its estimates with the truth."""
    engine = Engine(params)
    out = run(engine, sensors(world) + fixes)
    index = {int(s): k for k, s in enumerate(world.stamps)}
    track = [o for o in out if isinstance(o, Estimate)]
    k = [index[e.stamp_ns] for e in track]
    errors = np.array([e.r_e - world.r_e[i] for e, i in zip(track, k, strict=True)])
    turns = [np.trace(e.C_b_G @ world.C_b_G[i].T) for e, i in zip(track, k, strict=True)]
    angles = np.rad2deg(np.arccos(np.clip((np.array(turns) - 1.0) / 2.0, -1.0, 1.0)))
    return Measured(
        engine,
        out,
        float(np.linalg.norm(errors, axis=1).max()),
        float(angles.max()),
        (track[-1].stamp_ns - int(world.stamps[0])) * 1e-9,
        errors,
    )


def restated(fixes, factor):
    """The same fixes with another stated variance."""
    return [dataclasses.replace(f, covariance_e=f.covariance_e * factor) for f in fixes]


def published_table(world):
    """Rows of the table of the printed filters."""
    for name in CONFIGURATIONS:
        for start, b in ((0.0, 0.99), (100.0, 0.99), (1e4, 0.9999)):
            for period, delay in ((0.1, 1.0), (2.0, 3.0)):
                params = world.params(configuration=name, published_start=start, forgetting=b)
                fixes = world.fixes(period, delay, rng=np.random.default_rng(2))
                m = measure(world, params, fixes)
                why = m.engine.divergence.split(' (at')[0] or 'still runs'
                cells = (name, f'{start:g}', f'{b:g}', f'{period:g}, {delay:g}')
                numbers = (f'{m.last_s:.1f}', f'{m.position:.1f}', f'{m.attitude_deg:.2g}')
                yield (*cells, *numbers, why)


def guarded_table(world):
    """Rows of the table of stated noise that is wrong."""
    for noise in ('none', 'adaptive_r', 'sage_husa'):
        row = [noise]
        for factor in (1.0, 4.0, 0.25, 0.0625):
            params = world.params(
                configuration='custom',
                delay_handling='back_propagate',
                noise_adaptation=noise,
                adaptive_floor=0.05,
                forgetting=0.98,
            )
            fixes = restated(world.fixes(0.5, 1.5, rng=np.random.default_rng(2)), factor)
            m = measure(world, params, fixes)
            half = m.errors[len(m.errors) // 2 :]
            row.append(f'{np.sqrt(np.mean(np.sum(half**2, axis=1))):.3f}')
        yield row


if __name__ == '__main__':
    a_world = World(300.0)
    for table in (published_table, guarded_table):
        for cells in table(a_world):
            sys.stdout.write(f'| {" | ".join(cells)} |\n')
        sys.stdout.write('\n')
