"""The checks of style look at every source: a folder left out by its name goes unnoticed."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def paths_printed_by(*command):
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return {(ROOT / line).resolve() for line in done.stdout.splitlines()}


@pytest.mark.skipif(not (ROOT / '.git').exists(), reason='not a git clone: nothing is tracked')
def test_ruff_checks_every_python_file_that_git_tracks():
    tracked = paths_printed_by('git', 'ls-files', '*.py')
    checked = paths_printed_by(sys.executable, '-m', 'ruff', 'check', '--show-files', '.')
    assert len(tracked) > 500
    assert {path for path in tracked if path.exists()} - checked == set()
