"""The programs that `ros2 run` starts: wherever the tree is, and however early Ctrl-C comes."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from polar_nav_tools.development.environment import shebang_of, write_programs

MODULE = """\
import sys
{first}

def main():
    print(sys.argv[1:])
    return 3
"""


def program(folder: Path, first: str = '') -> Path:
    (folder / 'somewhere.py').write_text(MODULE.format(first=first))
    write_programs(folder / 'lib', {'somewhere_node': 'somewhere:main'})
    return folder / 'lib/somewhere_node'


@pytest.mark.parametrize(
    'place', ['short', 'with a space', "with 'quotes' and a space", 'x' * 130], ids=range(4)
)
def test_a_program_runs_wherever_its_python_is(tmp_path, monkeypatch, place):
    python = tmp_path / place / 'python'
    python.parent.mkdir()
    python.symlink_to(sys.executable)
    monkeypatch.setattr(sys, 'executable', str(python))
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    done = subprocess.run([program(tmp_path), 'a b', '--c'], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (3, "['a b', '--c']\n"), done.stderr


def test_an_ordinary_place_has_an_ordinary_first_line():
    assert shebang_of('/home/me/polar_nav/.venv/bin/python') == (
        '#!/home/me/polar_nav/.venv/bin/python'
    )


def test_ctrl_c_while_a_program_imports_ends_it_without_a_traceback(tmp_path, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    slow = "print('importing', flush=True); import time; time.sleep(60)"
    process = subprocess.Popen(
        [program(tmp_path, slow)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == 'importing\n'
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (-signal.SIGINT, '')


def test_a_program_that_runs_has_the_usual_ctrl_c(tmp_path, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    slow = 'import time, builtins as b\n'
    slow += "print = lambda _: b.print('running', flush=True) or time.sleep(60)"
    process = subprocess.Popen(
        [program(tmp_path, slow)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == 'running\n'
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert 'KeyboardInterrupt' in err
