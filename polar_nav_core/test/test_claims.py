"""Processes that compile all kernels leave to each other what one has begun."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from compiled import jit_only

from polar_nav_core import background, claims

CORE = Path(claims.__file__).parents[1]
TRY = """
import fcntl, sys
from polar_nav_core import claims
with open(sys.argv[1], 'r+b') as file:
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, claims.place_of(sys.argv[2]))
    except BlockingIOError:
        print('held')
    else:
        print('free')
"""


def seen(folder, name):
    """What another process finds a claim to be."""
    program = [sys.executable, '-c', TRY, folder / claims.FILE, name]
    environment = {**os.environ, 'PYTHONPATH': str(CORE)}
    run = subprocess.run(program, env=environment, capture_output=True, text=True, check=True)
    return run.stdout.strip()


def test_a_claim_is_of_one_name_and_until_it_is_given_back(tmp_path):
    claims.claim(tmp_path, 'one')
    assert (seen(tmp_path, 'one'), seen(tmp_path, 'other')) == ('held', 'free')
    claims.claim(tmp_path, 'other')
    claims.release('one')
    assert (seen(tmp_path, 'one'), seen(tmp_path, 'other')) == ('free', 'held')
    claims.release('other')
    assert seen(tmp_path, 'other') == 'free'


def test_what_was_not_claimed_is_given_back_without_harm():
    claims.release('nothing')


def test_where_there_are_no_locks_nothing_is_claimed(tmp_path):
    claims.claim(tmp_path / 'not there', 'one')
    claims.release('one')


COMPILE = """
from polar_nav_core.kernels.frames import earth
import numpy as np
out = np.zeros(1)
earth.gravity_many(np.array([[0.0, 0.0, 6.36e6]]), out)
kernels = [k for k in vars(earth).values() if hasattr(k, 'stats')]
print(*sorted(k.__name__ for k in kernels for _ in range(sum(k.stats.cache_misses.values()))))
"""


@jit_only
@pytest.mark.slow
def test_two_compilers_compile_each_kernel_once(tmp_path):
    environment = {
        **os.environ,
        'PYTHONPATH': str(CORE),
        'POLAR_NAV_CACHE_DIR': str(tmp_path),
        background.COMPILES: '1',
    }
    program = [sys.executable, '-c', COMPILE]
    both = [
        subprocess.Popen(program, env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    compiled = [name for process in both for name in process.communicate()[0].split()]
    assert [process.returncode for process in both] == [0, 0]
    assert 'gravity_many' in compiled
    assert len(compiled) == len(set(compiled)) > 1
