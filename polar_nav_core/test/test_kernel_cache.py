"""The kernels' cache directory: keyed by every source, numba and CPU; always writable."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from compiled import jit_only

from polar_nav_core.kernels import cache
from polar_nav_core.kernels.frames import strapdown

pytestmark = pytest.mark.slow

KERNELS = Path(cache.__file__).parent
RUN = 'sins/run.py'


@pytest.fixture
def copy(tmp_path):
    """A copy of the folder of kernels, to be edited."""
    return Path(shutil.copytree(KERNELS, tmp_path / 'kernels'))


@pytest.fixture
def own_directory():
    """`cache._own_temporary_directory`, asked as if for the first time, also afterwards."""
    cache._own_temporary_directory.cache_clear()
    yield cache._own_temporary_directory
    cache._own_temporary_directory.cache_clear()


def forget() -> None:
    for remembered in (cache.sources_of, cache._imported, cache._content, cache._compiler):
        remembered.cache_clear()


@pytest.fixture(autouse=True)
def nothing_remembered():
    """Nothing that a test has changed is remembered by the next."""
    yield
    forget()


def key(source: Path) -> str:
    """What `cache.cache_key` returns in a process that has read nothing yet."""
    forget()
    return cache.cache_key(source)


def edit(path: Path) -> None:
    path.write_text(path.read_text() + '\n# edited\n')


def test_key_is_of_the_text_and_not_of_the_place(copy):
    assert key(copy / RUN) == key(KERNELS / RUN)


@pytest.mark.parametrize('edited', [RUN, 'sins/update.py', 'frames/earth.py', 'queues.py'])
def test_key_changes_with_every_source_that_a_kernel_stands_on(copy, edited):
    before = key(copy / RUN)
    edit(copy / edited)
    assert key(copy / RUN) != before


def test_key_stays_when_a_kernel_does_not_stand_on_what_was_edited(copy):
    before = key(copy / 'station/run.py'), key(copy / 'frames/earth.py')
    edit(copy / RUN)
    after = key(copy / 'station/run.py'), key(copy / 'frames/earth.py')
    assert after == before


def test_sources_are_all_files_that_importing_a_kernel_brings():
    """Against Python's own import: no way to import a file is overlooked."""
    for source in (KERNELS / RUN, KERNELS / 'station/run.py'):
        name = 'polar_nav_core.kernels.' + '.'.join(source.relative_to(KERNELS).parts)[:-3]
        code = (
            'import sys, pathlib, polar_nav_core.kernels\n'
            f'import {name}\n'
            'for name, module in sys.modules.items():\n'
            '    if name.startswith("polar_nav_core.kernels."): print(module.__file__)\n'
        )
        run = subprocess.run(
            [sys.executable, '-c', code], capture_output=True, text=True, check=True
        )
        loaded = {Path(line) for line in run.stdout.split()}
        always = {KERNELS / 'cache.py', KERNELS / 'inner.py', *KERNELS.rglob('__init__.py')}
        assert loaded - always == set(cache.sources_of(source)) - always


def test_key_changes_with_the_numbers_that_the_engine_has_in_common_with_kernels(
    tmp_path, monkeypatch
):
    before = key(KERNELS / RUN)
    copy = tmp_path / 'order.py'
    copy.write_text(cache._ORDER.read_text().replace('FUSED = 1', 'FUSED = 2'))
    monkeypatch.setattr(cache, '_ORDER', copy)
    assert key(KERNELS / RUN) != before


def test_key_changes_with_cpu_and_numba(monkeypatch):
    before = key(KERNELS / RUN)
    monkeypatch.setattr(numba.config, 'CPU_NAME', 'generic')
    generic = key(KERNELS / RUN)
    monkeypatch.setattr(numba, '__version__', '0.0.0')
    assert len({before, generic, key(KERNELS / RUN)}) == 3


@pytest.mark.parametrize(
    ('environment', 'expected'),
    [
        ({'POLAR_NAV_CACHE_DIR': '{tmp}/mine', 'XDG_CACHE_HOME': '{tmp}/xdg'}, '{tmp}/mine'),
        ({'XDG_CACHE_HOME': '{tmp}/xdg'}, '{tmp}/xdg/polar_nav/kernels'),
        ({}, '{tmp}/home/.cache/polar_nav/kernels'),
    ],
)
def test_place(tmp_path, monkeypatch, environment, expected):
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'environment'))
    for name in ('POLAR_NAV_CACHE_DIR', 'XDG_CACHE_HOME'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))
    for name, value in environment.items():
        monkeypatch.setenv(name, value.format(tmp=tmp_path))
    directory = cache.cache_directory.__wrapped__(KERNELS / RUN)
    assert directory.parent == Path(expected.format(tmp=tmp_path))
    assert directory.name.startswith('sins.run-')
    assert directory.is_dir()


@pytest.mark.parametrize('home', ['one', 'other'])
def test_one_checkout_compiles_once_for_all_homes(tmp_path, monkeypatch, home):
    monkeypatch.delenv('POLAR_NAV_CACHE_DIR', raising=False)
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / home))
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'venv'))
    (tmp_path / 'venv').mkdir()
    (tmp_path / 'venv' / cache.OWN_ENVIRONMENT).touch()
    directory = cache.cache_directory.__wrapped__(KERNELS / RUN)
    assert directory.parent == tmp_path / 'venv' / 'kernels'
    (tmp_path / 'venv' / 'kernels').rename(tmp_path / 'gone')
    (tmp_path / 'venv' / 'kernels').write_text('')  # as if nobody could write there
    directory = cache.cache_directory.__wrapped__(KERNELS / RUN)
    assert directory.parent == tmp_path / home / 'polar_nav' / 'kernels'


@jit_only
def test_compiled_kernels_are_counted(tmp_path, monkeypatch):
    strapdown_file = Path(strapdown.__file__)
    monkeypatch.setattr(cache, 'cache_directory', lambda source: tmp_path / source.stem)
    done, total = cache.compiled()
    assert done == 0
    assert total > 200
    (tmp_path / 'strapdown').mkdir()
    (tmp_path / 'strapdown' / 'strapdown.strapdown_step-40.py311.nbi').touch()
    (tmp_path / 'strapdown' / 'strapdown.strapdown_step_more-40.py311.nbi').touch()
    assert cache.compiled() == (1, total)
    assert strapdown_file.exists()


@pytest.mark.usefixtures('own_directory')
def test_temporary_directory_when_home_cannot_be_written(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'environment'))
    not_a_directory = tmp_path / 'file'
    not_a_directory.write_text('')
    monkeypatch.delenv('POLAR_NAV_CACHE_DIR', raising=False)
    monkeypatch.delenv('XDG_CACHE_HOME', raising=False)
    monkeypatch.setenv('HOME', str(not_a_directory))
    monkeypatch.setattr(cache.tempfile, 'gettempdir', lambda: str(tmp_path))
    directory = cache.cache_directory.__wrapped__(KERNELS / RUN)
    assert directory.parent == tmp_path / f'polar_nav_kernels_{os.getuid()}'
    assert directory.parent.stat().st_mode & 0o777 == 0o700


def test_somebody_elses_temporary_directory_is_not_trusted(tmp_path, monkeypatch, own_directory):
    monkeypatch.setattr(cache.tempfile, 'gettempdir', lambda: str(tmp_path))
    monkeypatch.setattr(cache.tempfile, 'tempdir', str(tmp_path))
    planted = tmp_path / f'polar_nav_kernels_{os.getuid()}'
    planted.mkdir()
    planted.chmod(0o777)
    assert planted != own_directory()


@jit_only
def test_kernels_are_cached_there_and_numbas_own_setting_is_left_alone():
    path = Path(strapdown.strapdown_step._cache.cache_path)
    assert cache.cache_directory(Path(strapdown.__file__)) == path
    assert os.environ.get('NUMBA_CACHE_DIR', '') == numba.config.CACHE_DIR
    assert os.environ.get('NUMBA_CACHE_LOCATOR_CLASSES', '') == numba.config.CACHE_LOCATOR_CLASSES


@jit_only
def test_a_copy_of_the_sources_loads_what_another_compiled(tmp_path, monkeypatch):
    """Another place, another time of the file: a build, an install, a second checkout."""
    code = (
        'from .cache import entry, kernel\n\n\n@entry\n@kernel\ndef twice(x):\n    return 2 * x\n'
    )
    monkeypatch.setenv('POLAR_NAV_CACHE_DIR', str(tmp_path / 'cache'))
    hits = []
    for k, name in enumerate(('first', 'second')):
        package = tmp_path / name / 'polar_nav_core' / 'kernels'
        package.mkdir(parents=True)
        beside = ('order.py', 'background.py', 'claims.py')
        for file in ('kernels/cache.py', 'kernels/inner.py', *beside):
            shutil.copy(KERNELS.parent / file, package.parent / file)
        for folder in (package, package.parent):
            (folder / '__init__.py').touch()
        (package / 'twice.py').write_text(code)
        os.utime(package / 'twice.py', (k, k))
        show = 'from polar_nav_core.kernels.twice import twice as f\n'
        show += 'print(f(2.0), len(f.stats.cache_hits))'
        run = subprocess.run(
            [sys.executable, '-c', show],
            env={**os.environ, 'PYTHONPATH': str(tmp_path / name)},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        hits.append(run.stdout.split())
    assert hits == [['4.0', '0'], ['4.0', '1']]


@jit_only
def test_python_calls_a_kernel_that_is_no_entry_by_a_copy_of_its_own(monkeypatch, tmp_path):
    """Without what numba would call it by, that would end the process."""
    monkeypatch.setenv('POLAR_NAV_CACHE_DIR', str(tmp_path))
    cache.cache_directory.cache_clear()
    inner = cache.kernel(_twice)
    outer = cache.entry(cache.kernel(_outer_of(inner)))
    assert outer(2.0) == 5.0
    assert inner(2.0) == 4.0
    assert inner(3.0) == 6.0
    assert not list(inner.stats.cache_hits)
    kept = {path.parent.name.endswith('-entries') for path in tmp_path.rglob('*_twice*.nbi')}
    assert kept == {False, True}
    cache.cache_directory.cache_clear()


def _twice(x):
    return 2.0 * x


def _outer_of(inner):
    def outer(x):
        return inner(x) + 1.0

    return outer


def test_a_folder_of_kernels_elsewhere_has_a_directory_of_its_own(tmp_path):
    elsewhere = tmp_path / 'bags' / 'kernels'
    elsewhere.mkdir(parents=True)
    (elsewhere / 'records.py').write_text('')
    assert cache.folder_of(elsewhere / 'records.py') == elsewhere
    assert cache.folder_of(Path(strapdown.__file__)) == KERNELS


@jit_only
def test_a_kernel_that_allocates_does_not_compile():
    def allocates(n: int) -> float:
        return np.zeros(n)[0]

    with pytest.raises(numba.core.errors.NumbaError):
        cache.kernel(allocates)(3)


def test_without_jit_the_same_numbers_come_out():
    code = (
        'import numpy as np\n'
        'from polar_nav_core import strapdown\n'
        's = strapdown.Strapdown(np.eye(3), [1.0, 2.0, 0.1], [0.0, 0.0, 6356652.0])\n'
        's.run(np.full((20, 3), 1e-3), np.full((20, 3), [1e-3, 2e-3, 0.0983]), 0.01, block=5)\n'
        'print([float(x).hex() for x in (*s.C_b_G.ravel(), *s.v_G, *s.r_e)])\n'
    )
    results = []
    for flag in ('0', '1'):
        run = subprocess.run(
            [sys.executable, '-c', code],
            env={**os.environ, 'NUMBA_DISABLE_JIT': flag, 'PYTHONPATH': str(KERNELS.parents[1])},
            capture_output=True,
            text=True,
            check=True,
            timeout=100,
        )
        results.append([float.fromhex(x) for x in eval(run.stdout)])
    np.testing.assert_allclose(results[0], results[1], rtol=0.0, atol=2e-9)
    np.testing.assert_allclose(results[0][:12], results[1][:12], rtol=0.0, atol=1e-14)
