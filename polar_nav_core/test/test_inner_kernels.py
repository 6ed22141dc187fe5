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
from polar_nav_core.kernels.cache import apart, entry, kernel, routine


@kernel
def once(x):
    return x / 3.0


@routine
def twice(x):
    return once(x) + once(x + 1.0)


@apart
@routine
def alone(x):
    return twice(x)


@routine
def beyond(x):
    return alone(x)


@entry
@kernel
def first(x):
    return twice(x)


@entry
@kernel
def second(x):
    return twice(x) + once(x)


@entry
@kernel
def third(x):
    return alone(x)


@entry
@kernel
def fourth(x):
    return beyond(x) + once(x)


@entry
@kernel
def fifth(x):
    return beyond(x) - once(x)
"""
SHOW = """
import sys, chain
for name in sys.argv[2:]:
    getattr(chain, name)(1.5)
print(getattr(chain, sys.argv[1])(1.5))
kernels = [getattr(chain, name) for name in NAMES]
for stats in ('cache_hits', 'cache_misses'):
    print(*(sum(getattr(k.stats, stats).values()) for k in kernels))
libraries = [made.library for made in chain.alone.overloads.values()]
symbols = [f.name for library in libraries for f in library._final_module.functions]
print(*sorted(s for s in symbols if 'alone' in s))
"""


@pytest.fixture
def calls(tmp_path):
    """Value, hits and misses of kernels, and symbols of `alone`, of a process that calls some."""
    (tmp_path / 'chain.py').write_text(SOURCE)
    core = Path(cache.__file__).parents[2]

    def call(kernel, *before, names=('once', 'twice', 'first', 'second'), kept='cache'):
        run = subprocess.run(
            [sys.executable, '-c', SHOW.replace('NAMES', repr(names)), kernel, *before],
            env={
                **os.environ,
                'POLAR_NAV_CACHE_DIR': str(tmp_path / kept),
                'PYTHONPATH': f'{tmp_path}:{core}',
            },
            capture_output=True,
            text=True,
            check=True,
        )
        value, hits, misses, symbols = run.stdout.splitlines()
        return float(value), hits, misses, symbols

    return call


WHOLE = 1.5 / 3.0 + 2.5 / 3.0


@pytest.mark.slow
@jit_only
def test_an_entry_links_what_another_process_compiled(calls):
    said = [calls(name) for name in ('first', 'second', 'second')]
    assert [value for value, *_ in said] == [WHOLE, WHOLE + 0.5, WHOLE + 0.5]
    compiled, linked, loaded = ((hits, misses) for _, hits, misses, _ in said)
    assert compiled == ('0 0 0 0', '1 1 1 0')
    assert linked == ('1 1 0 0', '0 0 0 1')
    assert loaded == ('0 0 0 1', '0 0 0 0')


APART = ('twice', 'alone', 'beyond', 'third', 'fourth', 'fifth')


@pytest.mark.slow
@jit_only
def test_what_is_apart_is_compiled_once_and_loaded_with_those_that_call_it(calls):
    """Also through a kernel between, which came from the cache itself."""
    said = [calls(name, names=APART) for name in ('third', 'fourth', 'fifth', 'fifth')]
    assert [value for value, *_ in said] == [WHOLE, WHOLE + 0.5, WHOLE - 0.5, WHOLE - 0.5]
    assert [(hits, misses) for _, hits, misses, _ in said] == [
        ('0 0 0 0 0 0', '1 1 0 1 0 0'),
        ('0 1 0 0 0 0', '0 0 1 0 1 0'),
        ('0 1 1 0 0 0', '0 0 0 0 0 1'),
        ('0 1 0 0 0 1', '0 0 0 0 0 0'),
    ]
    value, *_ = calls('beyond')  # by a copy of its own
    assert value == WHOLE


@pytest.mark.slow
@jit_only
def test_what_is_apart_has_one_name_in_all_processes(calls):
    """Numba numbers functions as they come: a process would call what no other has."""
    early = calls('third', kept='one')[-1]
    late = calls('third', 'first', 'second', kept='other')[-1]
    assert early == late
    assert 'alone' in early


@pytest.mark.slow
@jit_only
def test_what_is_apart_is_compiled_again_where_it_is_lost(calls, tmp_path):
    """Without it the process that loads its caller would end."""
    calls('third')
    for file in (tmp_path / 'cache').rglob('*alone*'):
        file.unlink()
    value, hits, misses, _ = calls('third', names=APART)
    assert (value, hits, misses) == (WHOLE, '1 0 0 1 0 0', '0 1 0 0 0 0')


@jit_only
@pytest.mark.usefixtures('own_cache')
def test_apart_gives_the_same_bits(monkeypatch, tmp_path):
    alone, linked = numbers(), numbers()
    turned = cache.apart(cache.routine(turn))

    def turn_often(x):
        for k in range(50):
            turned(0.1 * k, x)

    cache.entry(cache.routine(turn_often))(alone)
    (compiled,) = turned.overloads.values()
    assert isinstance(compiled.library, inner.Apart)
    monkeypatch.setenv('POLAR_NAV_CACHE_DIR', str(tmp_path / 'another'))
    cache.cache_directory.cache_clear()
    pair()[1](linked)
    assert alone.tobytes() == linked.tobytes()
