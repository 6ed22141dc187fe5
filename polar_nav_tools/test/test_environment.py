"""The programs that `ros2 run` starts: wherever the tree is, and however early Ctrl-C comes."""

import hashlib
import re
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from polar_nav_tools.development.environment import (
    ROOT,
    lock_text,
    pins_of,
    shebang_of,
    write_programs,
)

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
    assert shebang_of('/opt/polar_nav/.venv/bin/python') == '#!/opt/polar_nav/.venv/bin/python'


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


def _entry(name, version, digest):
    hashes = {'archive_info': {'hashes': {'sha256': digest}}}
    return {'metadata': {'name': name, 'version': version}, 'download_info': hashes}


def test_a_lock_file_has_the_hash_of_every_wheel():
    reports = [
        {'install': [_entry('Num_Py', '2.0', 'a' * 64), _entry('rich', '15.0', 'c' * 64)]},
        {'install': [_entry('num.py', '2.0', 'b' * 64), _entry('rich', '15.0', 'c' * 64)]},
    ]
    _, _, *lines = lock_text([pins_of(r) for r in reports]).splitlines()
    assert lines == [
        'num-py==2.0 \\',
        f'    --hash=sha256:{"a" * 64} \\',
        f'    --hash=sha256:{"b" * 64}',
        'rich==15.0 \\',
        f'    --hash=sha256:{"c" * 64}',
    ]


def test_every_pin_of_the_lock_file_has_a_hash_and_no_place():
    text = (ROOT / 'requirements.lock').read_text()
    pins = re.findall(r'^[a-z0-9-]+==[\w.+!-]+', text, re.MULTILINE)
    hashed = re.findall(
        r'^[a-z0-9-]+==[\w.+!-]+(?: \\\n    --hash=sha256:[0-9a-f]{64})+$', text, re.MULTILINE
    )
    assert len(pins) == len(hashed) > 200
    assert '://' not in text


def test_pip_refuses_another_file_than_the_pinned_one(tmp_path):
    """A wheel of the same name and version with other content, as a registry might hand out."""
    wheel = tmp_path / 'thing-1.0-py3-none-any.whl'
    with zipfile.ZipFile(wheel, 'w') as file:
        info = 'thing-1.0.dist-info'
        file.writestr(f'{info}/METADATA', 'Metadata-Version: 2.1\nName: thing\nVersion: 1.0\n')
        file.writestr(f'{info}/WHEEL', 'Wheel-Version: 1.0\nTag: py3-none-any\n')
        file.writestr(f'{info}/RECORD', '')
    lock = tmp_path / 'requirements.lock'
    pip = [sys.executable, '-m', 'pip', 'install', '--dry-run', '--no-deps', '--no-index']
    pip += ['--find-links', str(tmp_path), '--require-hashes', '-r', str(lock)]
    for digest, status in ((hashlib.sha256(wheel.read_bytes()).hexdigest(), 0), ('0' * 64, 1)):
        lock.write_text(lock_text([{'thing==1.0': digest}]))
        done = subprocess.run(pip, capture_output=True, text=True, check=False)
        assert done.returncode == status, done.stderr
    assert 'DO NOT MATCH THE HASHES' in done.stderr
