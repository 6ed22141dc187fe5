"""Compiles all kernels of nodes and replays into the cache.

``python -m polar_nav_core.warm`` is part of the set-up, which goes on with it in the background: a
cold compile takes long, and a live node would fall behind its sensors meanwhile.
"""

from __future__ import annotations

import ctypes
import gc
import mmap
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numba.core.registry import CPUDispatcher

from . import background, earth, grid, local_frame, nav_columns, strapdown
from .kernels import cache, watch

if TYPE_CHECKING:
    from .engine.params import EngineParams
    from .engine.run import Inputs

_START_NS = 1_000_000_000
_IMU_NS = 10_000_000
_FIRST = 'clone'
"""How nodes treat late fixes, as a rule: what that takes is compiled first."""
_KERNELS = f'{__package__}.kernels.'


@contextmanager
def telling(say: Callable[[str], None], every_s: float = 10.0) -> Iterator[None]:
    """Say every few seconds how many kernels are compiled, while the block runs."""
    over = threading.Event()

    def tell() -> None:
        while not over.wait(every_s):
            done, total = cache.compiled()
            say(f'{done} of {total} kernels are compiled')

    thread = threading.Thread(target=tell, name='compiling', daemon=True)
    thread.start()
    before, background.say = background.say, None
    try:
        yield
    finally:
        background.say = before
        over.set()
        thread.join()


def forgo_blas() -> None:
    """Have numba begin without a BLAS, which no kernel here uses: scipy's takes 8 MB.

    For a process of its own, before the first kernel is loaded: other compiled functions in it
    cannot multiply matrices by ``@``. scipy itself stays as it is.
    """
    name = 'scipy.linalg'
    if name in sys.modules or 'numba.np.arraymath' in sys.modules:
        return
    sys.modules[name] = None  # type: ignore[assignment]  # importing it is an ImportError
    try:
        import_module('numba.np.arraymath')
    finally:
        del sys.modules[name]


def warm_node(handling: str) -> None:
    """Load the kernels of a live SINS node that treats late fixes in one way.

    While not all kernels are compiled it compiles all of them, unless `background` does: then it
    waits for those it needs. What the node does not need of the compiler's memory is freed.
    """
    done, total = cache.compiled()
    if done < total and not background.compiles():
        warm_filter()
        warm_smoother()
    else:
        warm_filter((handling,), whole=False)
    drop_intermediate_code()


def warm_filter(handling: Sequence[str] = (), *, whole: bool = True) -> None:
    """Run ways to treat late fixes over a third of a second, live and as a whole run.

    All ways by default; without ``whole`` only live.
    """
    # Here, because the engine stands above the kernels.
    from .engine import lever, now
    from .engine import run as engine_run
    from .engine.methods import DELAY_HANDLING
    from .engine.params import EngineParams
    from .engine.sins.filter import NavigationFilter
    from .engine.sins.view import place_of

    if whole:
        lever.warm_up()
    base = EngineParams(configuration='custom')
    inputs = _third_of_a_second(base)
    initial = base.initial_state()
    if initial is not None:  # what a restart, a turned track and model aiding correct it by
        f = NavigationFilter(base, initial, _START_NS)
        f.feed_back(np.zeros(24))
        warm_looks()
        place_of(f)
        now.warm_up(f)
        local_frame.warm_up()
    for name in handling or DELAY_HANDLING:
        params = replace(base, delay_handling=name)
        if whole:
            engine_run.run(params, inputs)
        engine_run.run(params, inputs, one_by_one=True)


def warm_looks() -> None:
    """Load what the watchdog of either mode asks once a second."""
    from .engine.health.radius import radius_95
    from .engine.health.statistics import statistics
    from .engine.health.watchdog import FIX, judged

    radius_95(np.eye(2))
    s = statistics(np.zeros((watch.STREAMS, watch.MEMORIES, watch.WIDTH)))
    judged(s, s.grid, s.grid_rise, FIX)


def warm_places(*, read_only: bool = False) -> None:
    """Load what nodes of a simulation ask at a position.

    Commands ask it at those of a bag, to which nobody writes: to a kernel that is another type.
    """
    r_e = np.array([0.0, 0.0, earth.SEMI_MINOR])
    r_e.setflags(write=not read_only)
    grid.ecef_to_grid(r_e)
    grid.earth_rate(r_e)
    earth.gravity(r_e)
    earth.up(r_e)


def warm_updates() -> None:
    """Fuse a fix at the present and a late one, without the loop over samples."""
    from .engine.params import EngineParams
    from .engine.sins.clone import Clone
    from .engine.sins.filter import NavigationFilter
    from .errors import FilterDivergence

    params = EngineParams(configuration='custom', delay_handling=_FIRST)
    initial = params.initial_state()
    if initial is not None:
        with suppress(FilterDivergence):  # there is no fix in the scratch
            NavigationFilter(params, initial, _START_NS).fuse_fix()
        fusion = Clone(params, initial, _START_NS)
        fusion.fix(_third_of_a_second(params).fixes[0])


def warm_smoother() -> None:
    """Smooth a third of a second, and whiten its innovations."""
    from .engine import innovations, smoothing
    from .engine.params import EngineParams
    from .engine.sins.filter import NavigationFilter
    from .kernels.sins import consider, hindsight

    params = EngineParams(configuration='default')
    initial = params.initial_state()
    if initial is not None:  # a third of a second needs no second pass
        f = NavigationFilter(params, initial, _START_NS)
        hindsight.hold(f.state, f.log, f.work.x)
    inputs = _third_of_a_second(params)
    smoothing.smooth(params, inputs, every_s=0.1)
    run = innovations.innovations(params, inputs)
    innovations.independent(run, np.zeros(consider.COLUMNS))


def _third_of_a_second(base: EngineParams) -> Inputs:
    """Samples at rest and late fixes of a vehicle."""
    from .engine import run as engine_run
    from .engine.events import Fix

    stamps = _START_NS + _IMU_NS * np.arange(30)
    pings, depths = stamps[5::10].copy(), stamps[4::10].copy()
    angles = np.radians([base.initial_latitude_deg, base.initial_longitude_deg])
    r_e = np.asarray(earth.ecef_from_geodetic(angles[0], angles[1], base.initial_height))
    return engine_run.Inputs(
        imu_stamps_ns=stamps,
        omega_ib_b=np.zeros((len(stamps), 3)),
        f_b=np.tile([0.0, 0.0, 9.83], (len(stamps), 1)),
        dvl_stamps_ns=pings,
        dvl_v_m=np.zeros((len(pings), 3)),
        dvl_covariance_m=np.tile(np.eye(3), (len(pings), 1, 1)),
        dvl_valid=np.ones(len(pings), dtype=bool),
        depth_stamps_ns=depths,
        depth=np.full(len(depths), -base.initial_height),
        depth_variance=np.ones(len(depths)),
        # The later ones are about times before the first was fused: delays overlap.
        fixes=tuple(
            Fix(v, v, received, 'leader', n, n, n, r_e, 1e4 * np.eye(3))
            for n, (v, received) in enumerate(
                (int(stamps[i]), int(stamps[j])) for i, j in ((3, 12), (4, 16), (2, 22))
            )
        ),
    )


def warm_station() -> None:
    """Run each way to treat late fixes of station mode, live and as a whole run."""
    from .engine import run as engine_run
    from .engine.events import Fix
    from .engine.methods import DELAY_HANDLING
    from .engine.params import EngineParams
    from .identification.polar_fix import PolarFix

    base = EngineParams(mode='station', configuration='custom', delay_handling='tagged')
    stamps = _START_NS + _IMU_NS * np.arange(45)
    polar = PolarFix(np.zeros(3), 0.0, 0.0, 50.0, 1.0, 0.3, 0.1, 1500.0)
    nothing = np.full(3, np.nan)
    inputs = engine_run.StationInputs(
        imu_stamps_ns=stamps,
        omega_ib_b=np.zeros((len(stamps), 3)),
        C_b_G=np.tile(np.eye(3), (len(stamps), 1, 1)),
        control_stamps_ns=stamps,
        force_b=np.ones((len(stamps), 3)),
        depth_stamps_ns=stamps,
        depth=np.full(len(stamps), -base.initial_height),
        depth_variance=np.ones(len(stamps)),
        fixes=tuple(
            Fix(v, v, received, 'station', n, n, n, nothing, np.eye(3) * np.nan, polar=polar)
            for n, (v, received) in enumerate(
                (int(stamps[i]), int(stamps[j])) for i, j in ((3, 12), (23, 30), (22, 40))
            )
        ),
    )
    for name in DELAY_HANDLING:
        for one_by_one in (False, True):
            engine_run.run(replace(base, delay_handling=name), inputs, one_by_one=one_by_one)
    engine_run.run(replace(base, station_filter='published'), inputs)
    warm_looks()


def warm_others() -> None:
    """Compile the kernels that the 24-state filter does not use.

    Strapdown, derived columns, station mode, identification.
    """
    from .identification import identifier

    warm_places(read_only=True)
    strapdown.warm_up()
    nav_columns.warm_up()
    warm_station()
    identifier.warm_up()


def drop_intermediate_code() -> int:
    """Return the number of loaded kernels whose intermediate code was freed.

    Beside the machine code of each kernel that it loads, numba holds its intermediate code, with
    which it compiles others that call it: more than a hundred megabytes in a follower.
    A kernel that is compiled later, against all expectation, reads that of its callees again from
    the cache. Kernels that this process compiled itself keep theirs. The code of the compiler
    leaves this process's memory as well, until it is called.
    """
    dropped = 0
    for dispatcher, signature, library in _loaded():
        if getattr(library, '_shared_module', None) is not None:
            library._get_module_for_linking = partial(_read_again, dispatcher, signature)
            library._shared_module = None
            dropped += 1
    gc.collect()
    _return_free_memory()
    _let_go_of_code('libllvmlite')
    return dropped


def _loaded() -> Iterator[tuple[Any, Any, Any]]:
    """Dispatcher, signature and library of each kernel that came from the cache."""
    modules = [m for name, m in sys.modules.items() if name.startswith(_KERNELS)]
    functions = {id(f): f for module in modules for f in vars(module).values()}
    for dispatcher in functions.values():
        if isinstance(dispatcher, CPUDispatcher):
            for signature in dispatcher.stats.cache_hits:
                yield dispatcher, signature, dispatcher.overloads[signature].library


def _read_again(dispatcher: Any, signature: Any) -> Any:  # noqa: ANN401 - numba's
    """Intermediate code of a kernel, as an LLVM module, from the cache."""
    again = dispatcher._cache.load_overload(signature, dispatcher.targetctx)
    return again.library._get_module_for_linking()


def _return_free_memory() -> None:
    """Have the C library return what it holds for later: arenas do not shrink by themselves."""
    trim = getattr(ctypes.CDLL(None), 'malloc_trim', None)
    if trim is not None:  # glibc
        trim(0)


def _let_go_of_code(library: str) -> None:
    """Take the machine code of a library out of this process's memory. Linux only.

    No one writes to it, so that the system reads it again from its file where it is called.
    """
    maps = Path('/proc/self/maps')
    advise = getattr(ctypes.CDLL(None), 'madvise', None)
    if advise is None or not maps.exists():
        return
    advise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    for line in maps.read_text(encoding='utf-8').splitlines():
        limits, access, *_, path = line.split(maxsplit=5)
        if access == 'r-xp' and library in path:
            begin, end = (int(x, 16) for x in limits.split('-'))
            advise(begin, end - begin, mmap.MADV_DONTNEED)


def _print_line(text: str) -> None:
    sys.stdout.write(f'{text}\n')
    sys.stdout.flush()


def _compile_in_parallel() -> None:
    """Fill the cache by two processes, which leave to each other what the other has begun.

    First what nodes load at their start, which others wait for: one process from the entry of the
    whole loop, the other from those of single updates. Then the rest.
    """
    os.environ[background.COMPILES] = '1'
    _collect_rarely()
    other = multiprocessing.get_context('spawn').Process(target=_compile_beside)
    other.start()
    with telling(_print_line, every_s=2.0):
        warm_places()
        warm_filter((_FIRST,), whole=False)
        warm_filter()
        warm_smoother()
        warm_others()
        other.join()
    if other.exitcode:
        sys.exit(other.exitcode)


def _compile_beside() -> None:
    _collect_rarely()
    warm_updates()
    warm_others()
    warm_smoother()
    warm_filter()


def _collect_rarely() -> None:
    """Look for garbage less often: a compiler makes many objects, and all of them for a kernel."""
    gc.set_threshold(100_000, 50, 100)


if __name__ == '__main__':
    _compile_in_parallel()
