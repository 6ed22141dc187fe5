"""The engine without its compiler: the same numbers, to rounding."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.methods import DELAY_HANDLING

SECONDS = 0.5


def results():
    """Last position, velocity and sigmas of a short run with two overlapping late fixes."""
    world = World(SECONDS)
    fixes = world.fixes(0.1, lambda i: 0.25 - 0.07 * (i % 2), first_s=0.1)
    found = {}
    for name in DELAY_HANDLING:
        params = world.params(configuration='custom', delay_handling=name, robust_fixes='huber')
        track = engine_run.run(params, inputs_of(world, fixes)).track
        sigma = np.sqrt(np.diagonal(track.P[-1]))
        found[name] = [*track.r_e[-1], *track.v_G[-1], *sigma]
    return found


def test_plain_python_gives_the_same_numbers():
    here = str(Path(__file__).parent)
    code = 'import json, test_plain_engine as t; print(json.dumps(t.results()))'
    run = subprocess.run(
        [sys.executable, '-c', code],
        capture_output=True,
        text=True,
        check=True,
        cwd=here,
        env={**os.environ, 'NUMBA_DISABLE_JIT': '1', 'PYTHONPATH': here},
    )
    plain = json.loads(run.stdout)
    for name, expected in results().items():
        assert plain[name] == pytest.approx(expected, rel=1e-12, abs=1e-12), name
