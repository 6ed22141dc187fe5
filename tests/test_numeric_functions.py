"""What may differ on another processor is listed, and nothing else is called."""

import importlib
import pkgutil
import re
import shutil
import subprocess
from pathlib import Path

import numba
import pytest
from numba.core.registry import CPUDispatcher
from numeric_functions import complaints, found_in, listed, sources

from polar_nav_core import kernels
from polar_nav_core.kernels import cache

FUNCTIONS = {
    '**': {'pow'},
    '%': {'fmod'},
    'math.sin': {'sin', 'sincos'},
    'math.cos': {'cos', 'sincos'},
}
"""What is called of libm by machine code, where it is not the name alone."""
NO_NUMBERS = re.compile(r'_?Py|numba_(adapt|attempt|do_raise|unpickle|runtime_build_ex)|mem\w+$')
"""Python's and numba's own, and copies of memory."""
FUSED = re.compile(rb'\b(?:vfn?m(?:add|sub)\w+|fn?m(?:add|sub)|fml[as])\b')
"""Instructions of x86-64 and of arm64 that round a product and a sum at once."""
needs_machine_code = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT) or not shutil.which('objdump'),
    reason='needs compiled kernels, and objdump (apt install binutils)',
)


@pytest.fixture(scope='module')
def found():
    """What the sources compute with."""
    return found_in(sources())


def test_every_function_is_listed_and_no_other(found):
    assert complaints(found, listed()) == []


def test_every_kind_has_its_reason():
    known = listed()
    assert {kind for where in ('compiled', 'python') for kind in known[where].values()} <= set(
        known['kinds']
    )
    assert set(known['compiled'].values()) <= {'exact', 'libm'}


KERNEL = """
import math
import numpy as np
from numpy import linalg as la
from scipy.special import gammaincinv as inverse
from .cache import kernel

ROOT = math.sqrt(2.0)

@kernel
def step(x: np.ndarray, limit: float = math.pi) -> float:
    return math.sinh(x[0]) ** 3 + x[1] % limit

def solve(A, b):
    A @= A
    return la.solve(A, b.sum(axis=0)) + max(map(np.cbrt, b)) + inverse(1.5, np.float64(0.5))
"""


def test_functions_are_found_by_whatever_name():
    found = found_in({'new.py': KERNEL})
    assert set(found['compiled']) == {'math.sinh', '**', '%'}
    assert set(found['python']) == {
        'math.sqrt', '@', 'numpy.linalg.solve', '.sum()', 'numpy.cbrt', 'scipy.special.gammaincinv'
    }  # fmt: skip
    assert found['python']['@'] == ['new.py:15']


def test_a_new_function_is_named_with_what_to_do(found):
    known = listed()
    del known['compiled']['**']
    known['python']['numpy.arccosh'] = 'libm'
    new = found_in({'new.py': KERNEL})
    said = complaints({where: {**names, **new[where]} for where, names in found.items()}, known)
    assert [sentence.partition(' (')[0] for sentence in said] == [
        '**', 'math.sinh', 'numpy.cbrt', 'numpy.arccosh',
    ]  # fmt: skip
    assert 'new.py:12' in said[1]
    assert 'say there of which kind it is (exact, libm, sums, library)' in said[1]
    assert said[3].endswith('no source uses it: remove it')


def compiled_objects() -> dict[str, bytes]:
    """Object files of all kernels, as they lie in the cache, by the kernels' names."""
    found = {}
    inside = f'{kernels.__name__}.'
    for module in pkgutil.walk_packages(kernels.__path__, inside):
        room = module.name.removeprefix(inside)
        for name, function in vars(importlib.import_module(module.name)).items():
            if isinstance(function, CPUDispatcher) and function.__module__ == module.name:
                file = function._cache._cache_file
                for k, kept in enumerate(file._load_index().values()):
                    _, kind, (machine_code, _) = file._load_data(kept)[0]
                    assert kind == 'object'
                    found[f'{room}.{name}-{k}'] = machine_code
    return found


@pytest.fixture(scope='module')
def objects(tmp_path_factory) -> Path:
    """Folder with those object files."""
    done, total = cache.compiled()
    if done < total:
        pytest.skip(f'{done} of {total} kernels are compiled (python -m polar_nav_core.warm)')
    folder = tmp_path_factory.mktemp('objects')
    for name, machine_code in compiled_objects().items():
        (folder / f'{name}.o').write_bytes(machine_code)
    return folder


def objdump(option: str, files: list[Path]) -> bytes:
    command = ['objdump', option, '--no-show-raw-insn', *files]
    return subprocess.run(command, capture_output=True, check=True).stdout


@needs_machine_code
def test_machine_code_calls_what_the_sources_do_and_nothing_else(objects):
    files = sorted(objects.iterdir())
    assert len(files) > 400
    symbols = objdump('-t', files).decode()
    called = set(re.findall(r'\*UND\*\s+\w+ (\w+)', symbols))
    # Kernels that are compiled apart are called by name, too.
    called -= set(re.findall(r' F \.l?text\s+\w+ (\w+)', symbols))
    called = {name for name in called if not NO_NUMBERS.match(name)}
    allowed = {
        name: FUNCTIONS.get(name, {name.rpartition('.')[2]}) for name in listed()['compiled']
    }
    assert called - set().union(*allowed.values()) == set()
    libm = {name for name, kind in listed()['compiled'].items() if kind == 'libm'}
    assert {name for name in libm if not allowed[name] & called} == set()


@pytest.mark.parametrize(
    ('line', 'fused'),
    [
        (b' 4:\tvfmadd231sd %xmm1,%xmm2,%xmm0', True),
        (b' 4:\tvfnmsub213pd %ymm1,%ymm2,%ymm0', True),
        (b' 4:\tfmadd\td0, d1, d2, d3', True),
        (b' 4:\tfnmsub\td0, d1, d2, d3', True),
        (b' 4:\tfmla\tv0.2d, v1.2d, v2.d[0]', True),
        (b' 4:\tvmulsd %xmm1,%xmm2,%xmm0', False),
        (b' 4:\tmadd\tx0, x1, x2, x3', False),
        (b' 4:\tfmul\td0, d1, d2', False),
    ],
)
def test_fused_instructions_are_known_on_both_architectures(line, fused):
    assert bool(FUSED.search(line)) == fused


@needs_machine_code
def test_machine_code_rounds_each_product_before_it_adds(objects):
    """Were they fused where a processor can, all else would differ from one to another."""
    for kernel in ('sins.run.advance', 'station.run.advance'):
        (file,) = objects.glob(f'{kernel}-*.o')
        code = objdump('-d', [file])
        assert len(code) > 100_000
        assert not FUSED.search(code), kernel
