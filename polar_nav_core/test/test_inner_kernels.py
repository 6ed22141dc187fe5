"""Kernels that only kernels call are linked: no machine code of their own, the same numbers."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from compiled import jit_only
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import Compiler

from polar_nav_core.kernels import cache, inner


@pytest.fixture
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv('POLAR_NAV_CACHE_DIR', str(tmp_path / 'cache'))
    cache.cache_directory.cache_clear()
    yield
    cache.cache_directory.cache_clear()


def turn(a, x):
    for k in range(len(x) - 1):
        first, second = x[k], x[k + 1]
        x[k] = math.cos(a) * first - math.sin(a) * second / 3.0
        x[k + 1] = math.sin(a) * first + math.cos(a) * second


def pair():
    """An inner kernel, and an entry that calls it in a loop."""
    turned = cache.routine(turn)

    def turn_often(x):
        for k in range(50):
            turned(0.1 * k, x)

    return turned, cache.entry(cache.routine(turn_often))


def numbers():
    return np.random.default_rng(1).normal(size=9)


def test_numba_has_what_inner_kernels_stand_on():
    assert inner.missing() == [], (
        f'numba {numba.__version__} lacks these: kernels that only kernels call are compiled as '
        'numba compiles all others, and the set-up takes minutes longer; see kernels/inner.py'
    )


def test_what_numba_lacks_is_named(monkeypatch):
    monkeypatch.delattr(CPUCodeLibrary, '_finalize_dynamic_globals')
    assert inner.missing() == ['JITCodeLibrary._finalize_dynamic_globals']


@jit_only
@pytest.mark.usefixtures('own_cache')
def test_only_entries_are_machine_code():
    turned, turn_often = pair()
    x = numbers()
    turn_often(x)
    for kernel, own in ((turned, False), (turn_often, True)):
        (compiled,) = kernel.overloads.values()
        assert isinstance(compiled.library, inner.LinkedOnly) is not own
        engine = compiled.library.codegen._engine
        assert engine.is_symbol_defined(compiled.fndesc.llvm_func_name) is own
    expected = numbers()
    for k in range(50):
        turn(0.1 * k, expected)
    np.testing.assert_allclose(x, expected, rtol=1e-12)


@jit_only
@pytest.mark.usefixtures('own_cache')
def test_numbas_own_way_gives_the_same_bits(monkeypatch, tmp_path):
    """What is left where `missing` names something."""
    linked, ordinary = numbers(), numbers()
    pair()[1](linked)
    monkeypatch.setenv('POLAR_NAV_CACHE_DIR', str(tmp_path / 'another'))
    cache.cache_directory.cache_clear()
    monkeypatch.setattr(inner, 'COMPILER', Compiler)
    turned, turn_often = pair()
    turn_often(ordinary)
    (compiled,) = turned.overloads.values()
    assert not isinstance(compiled.library, inner.LinkedOnly)
    assert linked.tobytes() == ordinary.tobytes()


SOURCE = """
from polar_nav_core.kernels.cache import entry, kernel, routine


@kernel
def once(x):
    return x / 3.0


@routine
def twice(x):
    return once(x) + once(x + 1.0)


@entry
@kernel
def first(x):
    return twice(x)


@entry
@kernel
def second(x):
    return twice(x) + once(x)
"""
SHOW = """
import sys
from chain import first, once, second, twice
print({'first': first, 'second': second}[sys.argv[1]](1.5))
print(*(sum(k.stats.cache_hits.values()) for k in (once, twice, first, second)))
print(*(sum(k.stats.cache_misses.values()) for k in (once, twice, first, second)))
"""


@pytest.mark.slow
@jit_only
def test_an_entry_links_what_another_process_compiled(tmp_path):
    (tmp_path / 'chain.py').write_text(SOURCE)
    core = Path(cache.__file__).parents[2]
    environment = {
        **os.environ,
        'POLAR_NAV_CACHE_DIR': str(tmp_path / 'cache'),
        'PYTHONPATH': f'{tmp_path}:{core}',
    }
    said = [
        subprocess.run(
            [sys.executable, '-c', SHOW, name],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.splitlines()
        for name in ('first', 'second', 'second')
    ]
    whole = 1.5 / 3.0 + 2.5 / 3.0
    assert [float(lines[0]) for lines in said] == [whole, whole + 0.5, whole + 0.5]
    compiled, linked, loaded = ((lines[1], lines[2]) for lines in said)
    assert compiled == ('0 0 0 0', '1 1 1 0')
    assert linked == ('1 1 0 0', '0 0 0 1')
    assert loaded == ('0 0 0 1', '0 0 0 0')
