"""The programs that `ros2 run` starts: wherever the tree is, and however early Ctrl-C comes."""

import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from polar_nav_tools.development import environment
from polar_nav_tools.development.environment import (
    ROOT,
    as_uv_takes_it,
    lock_text,
    pins_of,
    pip_settings,
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


@pytest.fixture
def wheel(tmp_path):
    path = tmp_path / 'thing-1.0-py3-none-any.whl'
    with zipfile.ZipFile(path, 'w') as file:
        info = 'thing-1.0.dist-info'
        file.writestr(f'{info}/METADATA', 'Metadata-Version: 2.1\nName: thing\nVersion: 1.0\n')
        file.writestr(f'{info}/WHEEL', 'Wheel-Version: 1.0\nTag: py3-none-any\n')
        file.writestr(f'{info}/RECORD', '')
    return path


@pytest.mark.slow
def test_pip_refuses_another_file_than_the_pinned_one(tmp_path, wheel):
    """A wheel of the same name and version with other content, as a registry might hand out."""
    lock = tmp_path / 'requirements.lock'
    pip = [sys.executable, '-m', 'pip', 'install', '--dry-run', '--no-deps', '--no-index']
    pip += ['--find-links', str(tmp_path), '--require-hashes', '-r', str(lock)]
    for digest, status in ((hashlib.sha256(wheel.read_bytes()).hexdigest(), 0), ('0' * 64, 1)):
        lock.write_text(lock_text([{'thing==1.0': digest}]))
        done = subprocess.run(pip, capture_output=True, text=True, check=False)
        assert done.returncode == status, done.stderr
    assert 'DO NOT MATCH THE HASHES' in done.stderr


LISTED = """\
:env:.default-timeout='60'
:env:.disable-pip-version-check='1'
freeze.timeout='1'
global.cert='/etc/ssl/ours.pem'
global.extra-index-url='\\nhttps://two.example/simple\\nhttps://three.example/simple'
global.index-url='https://one.example/simple'
global.no-index='false'
global.proxy='http://proxy.example:3128'
global.timeout='10'
global.trusted-host='one.example'
install.find-links='/opt/wheels'
install.index-url='https://name:a%20b=c@mirror.example/simple'
"""
"""What ``pip config list`` prints."""


def test_uv_takes_files_from_where_pip_does():
    options, variables = as_uv_takes_it(pip_settings(LISTED))
    assert options == [
        *('--default-index', 'https://name:a%20b=c@mirror.example/simple'),
        *('--index', 'https://two.example/simple', '--index', 'https://three.example/simple'),
        *('--find-links', '/opt/wheels'),
        *('--allow-insecure-host', 'one.example'),
        *('--cert', '/etc/ssl/ours.pem'),
    ]
    proxy = 'http://proxy.example:3128'
    assert variables == {
        **dict.fromkeys(('HTTP_PROXY', 'HTTPS_PROXY', 'ALL_PROXY'), proxy),
        'UV_HTTP_TIMEOUT': '10',
    }


def test_without_settings_of_pip_uv_has_its_own():
    assert as_uv_takes_it(pip_settings('')) == ([], {})


def test_what_pip_prints_of_its_settings_is_understood(tmp_path):
    """By the pip of this environment, from a file and from variables."""
    file = tmp_path / 'pip.conf'
    file.write_text('[global]\nfind-links =\n    /one\n    /two\n[install]\nno-index = true\n')
    env = {'PATH': os.environ['PATH'], 'PIP_CONFIG_FILE': str(file), 'PIP_CERT': '/a file.pem'}
    pip = [sys.executable, '-m', 'pip', 'config', 'list']
    listed = subprocess.run(pip, env=env, check=True, capture_output=True, text=True).stdout
    options, _ = as_uv_takes_it(pip_settings(listed))
    assert options[:4] == ['--find-links', '/one', '--find-links', '/two']
    assert options[-3:] == ['--no-index', '--cert', '/a file.pem']


@pytest.mark.slow
def test_uv_takes_the_pinned_file_and_refuses_another(tmp_path, wheel):
    """With the options of the set-up and the settings of pip."""
    if shutil.which('uv', path=str(Path(sys.executable).parent)) is None:
        pytest.skip('uv is not in this environment')
    lock = tmp_path / 'requirements.lock'
    env = {
        **os.environ,
        'PIP_NO_INDEX': '1',
        'PIP_FIND_LINKS': str(tmp_path),
        'HOME': str(tmp_path),
    }
    command = [sys.executable, environment.__file__, 'install', '-r', str(lock), '--target']
    for digest, status in ((hashlib.sha256(wheel.read_bytes()).hexdigest(), 0), ('0' * 64, 1)):
        lock.write_text(lock_text([{'thing==1.0': digest}]))
        done = subprocess.run(
            [*command, str(tmp_path / f'target{status}')],
            env=env,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == status, done.stderr
    assert (tmp_path / 'target0/thing-1.0.dist-info').is_dir()
    assert not (tmp_path / 'target1/thing-1.0.dist-info').exists()
    assert 'Hash mismatch' in done.stderr
