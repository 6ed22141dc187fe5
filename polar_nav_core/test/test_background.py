"""Who misses a kernel that ``./polar`` compiles in the background waits for it."""

import fcntl
import os
import subprocess
import sys

import pytest
from compiled import jit_only

from polar_nav_core import background
from polar_nav_core.warm import telling


@pytest.fixture
def environment(tmp_path, monkeypatch):
    """An environment that ``./polar`` made, of this process and its children."""
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    monkeypatch.delenv(background.COMPILES, raising=False)
    (tmp_path / background.LOCK).touch()
    return tmp_path


@pytest.fixture
def compiling(environment):
    """The lock on it, as its compilers hold it."""
    with (environment / background.LOCK).open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield file


@pytest.fixture
def said(monkeypatch):
    lines: list[str] = []
    monkeypatch.setattr(background, 'say', lines.append)
    return lines


def test_nobody_compiles_without_such_an_environment(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    assert not background.compiles()


@pytest.mark.usefixtures('environment')
def test_a_lock_that_nobody_holds_says_nothing():
    assert not background.compiles()
    assert background.awaited(lambda: None) is None


@pytest.mark.usefixtures('compiling')
def test_compilers_do_not_wait_for_themselves(monkeypatch):
    assert background.compiles()
    monkeypatch.setenv(background.COMPILES, '1')
    assert not background.compiles()


def test_kernels_that_are_there_are_not_waited_for(environment, compiling):
    """What holds the lock still compiles Python's own bytecode, which nobody needs."""
    assert compiling.name == str(environment / background.LOCK)
    (environment / background.LOCK).write_text('4711 key\n')
    assert background.compiles()
    (environment / background.LOCK).write_text('4711 key kernels\n')
    assert not background.compiles()


@pytest.mark.usefixtures('compiling')
def test_what_is_there_is_not_waited_for(said):
    assert background.awaited(lambda: 'kernel') == 'kernel'
    assert said == []


@pytest.mark.usefixtures('compiling')
def test_what_comes_while_others_compile_is_taken_at_once(said, monkeypatch):
    monkeypatch.setattr(background, '_LOOK_EVERY_S', 0.0)
    looks = iter([None, None, 'kernel'])
    assert background.awaited(lambda: next(looks)) == 'kernel'
    assert background.compiles()
    assert said == ['waiting: kernels are compiled in the background']


@pytest.mark.usefixtures('said')
def test_what_does_not_come_is_waited_for_until_the_others_end(compiling, monkeypatch):
    monkeypatch.setattr(background, '_LOOK_EVERY_S', 0.0)
    looks = []

    def look():
        looks.append(None)
        if len(looks) == 5:
            fcntl.flock(compiling, fcntl.LOCK_UN)

    assert background.awaited(look) is None
    assert len(looks) == 6  # once more: it may have come with the end


@pytest.mark.usefixtures('compiling')
def test_the_line_has_how_far_the_compilers_are(environment, said, monkeypatch):
    monkeypatch.setattr(background, '_LOOK_EVERY_S', 0.0)
    log = '3 of 9 kernels are compiled\n7 of 9 kernels are compiled\nTraceback of something\n'
    (environment / background.LOG).write_text(log)
    background.awaited(iter([None, 'kernel']).__next__, 'tests wait')
    assert said == ['tests wait: 7 of 9 kernels are compiled in the background']


@pytest.mark.usefixtures('compiling')
def test_where_progress_is_told_anyway_nothing_is_said_twice(monkeypatch, capsys):
    monkeypatch.setattr(background, '_LOOK_EVERY_S', 0.0)
    with telling(lambda _: None):
        background.awaited(iter([None, 'kernel']).__next__)
    assert capsys.readouterr().err == ''
    background.awaited(iter([None, 'kernel']).__next__)
    assert capsys.readouterr().err.startswith('polar: waiting: kernels')


MISSES = """
import sys
sys.prefix = {prefix!r}
from polar_nav_core import background
from polar_nav_core.kernels.frames.earth import gravity_many
import numpy as np
background.say = lambda text: print('waits', flush=True)
out = np.zeros(1)
gravity_many(np.array([[0.0, 0.0, 6.36e6]]), out)
print(out[0] > 9.7, len(gravity_many.stats.cache_hits), flush=True)
"""


@jit_only
@pytest.mark.slow
def test_a_kernel_is_loaded_that_another_compiled_meanwhile(environment, monkeypatch):
    """Not compiled a second time: it came from the cache."""
    (environment / '.polar_setup').touch()
    monkeypatch.delenv('POLAR_NAV_CACHE_DIR', raising=False)
    program = [sys.executable, '-c', MISSES.format(prefix=str(environment))]
    with (environment / background.LOCK).open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as waiting:
            assert waiting.stdout is not None
            assert waiting.stdout.readline() == 'waits\n'
            compiler = {**os.environ, background.COMPILES: '1'}
            done = subprocess.run(
                program, env=compiler, check=True, capture_output=True, text=True
            )
            rest = waiting.stdout.read()
    assert done.stdout == 'True 0\n'
    assert rest.splitlines()[-1] == 'True 1'
    assert any((environment / 'kernels').glob('frames.earth-*/**/*gravity_many*.nbi'))
