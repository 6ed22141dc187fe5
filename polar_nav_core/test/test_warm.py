"""Set-up compiles every kernel that the engine calls: none is compiled while sensors wait."""

import ast
import subprocess
import sys

import numba
import numpy as np
import pytest
from closed_loop import World, run

from polar_nav_core import earth, grid
from polar_nav_core import warm as set_up
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.methods import DELAY_HANDLING
from polar_nav_core.kernels import cache
from polar_nav_core.kernels.frames import earth as earth_kernels
from polar_nav_core.kernels.frames.grid import fill_C_e_G_many
from polar_nav_core.kernels.sins import events as filter_events
from polar_nav_core.kernels.sins import late as filter_late
from polar_nav_core.kernels.sins import late_run
from polar_nav_core.kernels.sins import run as filter_run
from polar_nav_core.kernels.sins import update as kf
from polar_nav_core.warm import warm_filter, warm_others, warm_smoother

MODULES = (kf, filter_events, filter_late, filter_run, late_run)
ENTRIES = [
    'add_epoch',
    'advance',
    'advance_late',
    'begin_step',
    'cholesky',
    'feed_back_and_remember',
    'fill_shared',
    'fill_dvl',
    'fill_late_fix',
    'fuse_filled',
    'judge',
    'locate',
    'newest_until',
    'put_row',
    'restore',
    'take_late',
    'take_snapshot',
    'update',
]
"""What Python calls; what these inline or load from the cache has no signature of its own."""


def signatures():
    return {
        f'{m.__name__}.{n}': len(k.signatures)
        for m in MODULES
        for n, k in vars(m).items()
        if hasattr(k, 'signatures') and n in ENTRIES
    }


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_the_set_up_compiles_every_kernel_that_there_is():
    """A node that finds one missing compiles, or loads, all of them at its start."""
    for warm in (warm_filter, warm_others, warm_smoother):
        warm()
    done, total = cache.compiled()
    assert done == total


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_the_engine_needs_no_kernel_that_set_up_has_not_compiled():
    warm_filter()
    before = signatures()
    assert sum(n > 0 for n in before.values()) > 10
    world = World(8.0)
    rng = np.random.default_rng(0)
    fixes = world.fixes(0.5, lambda _: rng.uniform(0.0, 3.0), rng=rng)
    events = [*world.imu(), *world.dvl(), *world.depth(), *fixes]
    for name in DELAY_HANDLING:
        run(Engine(world.params(configuration='custom', delay_handling=name)), events)
    run(Engine(world.params(configuration='default', model_aiding=True)), events)
    assert signatures() == before


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_positions_of_a_bag_need_no_kernel_that_set_up_has_not_compiled():
    """Nobody writes to its columns: to a kernel that is another type."""
    warm_others()
    kernels = (earth_kernels.gravity_many, earth_kernels.up_and_height_many, fill_C_e_G_many)
    before = [len(k.signatures) for k in kernels]
    r_e = np.tile([0.0, 0.0, earth.SEMI_MINOR], (3, 1))
    r_e.setflags(write=False)
    grid.ecef_to_grid(r_e)
    earth.gravity(r_e)
    earth.up(r_e)
    assert [len(k.signatures) for k in kernels] == before


LOADED = """
import sys
from numba.core.registry import CPUDispatcher
from polar_nav_core import warm
from polar_nav_core.kernels.cache import Inner
{call}
modules = [m for name, m in list(sys.modules.items()) if ".kernels." in name]
kernels = [k for module in modules for k in vars(module).values()]
entries = [k for k in kernels if isinstance(k, CPUDispatcher) and not isinstance(k, Inner)]
print(*(f'{{k.__module__}}.{{k.__name__}}' for k in entries if k.overloads))
"""


def loaded_by(call: str) -> set[str]:
    """Entries of kernels that a process loads by a call."""
    program = [sys.executable, '-c', LOADED.format(call=call)]
    run = subprocess.run(program, capture_output=True, text=True, check=True)
    return {name.rpartition('kernels.')[2] for name in run.stdout.split()}


@pytest.mark.slow
@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_what_is_compiled_first_is_what_nodes_load_at_their_start():
    """Of the update at the present a node loads the machine code, and not the entry."""
    node = loaded_by(f'warm.warm_filter(({set_up._FIRST!r},), whole=False)')
    beside = loaded_by('warm.warm_updates()')
    assert len(node) > 15
    assert beside - node == {'sins.fuse.fuse_filled'}
    assert {'sins.late_run.take_late', 'sins.bridge.reach'} < beside


@pytest.mark.slow
@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='nothing is compiled')
def test_followers_of_both_modes_have_what_a_look_takes():
    looks = {
        'radius.radius_in_sigmas',
        'statistics.fill_statistics',
        'statistics.largest_share',
    }
    assert looks <= loaded_by('warm.warm_others()')
    assert looks | {'sins.look.look', 'imu_sequence.judge'} <= loaded_by(
        f'warm.warm_filter(({set_up._FIRST!r},), whole=False)'
    )


def test_every_kernel_is_called_by_the_package():
    """One that only tests call is not compiled by set-up, and a node then loads all there are."""
    package = cache.KERNELS.parent
    trees = [ast.parse(p.read_text(encoding='utf-8')) for p in sorted(package.rglob('*.py'))]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    used = {n.id for n in nodes if isinstance(n, ast.Name)}
    used |= {n.attr for n in nodes if isinstance(n, ast.Attribute)}
    compiled = {
        n.name
        for n in nodes
        if isinstance(n, ast.FunctionDef)
        and any(
            isinstance(d, ast.Name) and d.id in ('kernel', 'routine') for d in n.decorator_list
        )
    }
    assert len(compiled) > 300
    assert compiled - used == set()
