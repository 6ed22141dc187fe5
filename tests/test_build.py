"""The packages as ROS sees them: what they declare is what they use, and colcon builds them.

The build runs with the wheels of this environment, into a temporary folder, and leaves every
installed file as it was.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
from live_support import NODES

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = tuple(sorted(p.parent.name for p in ROOT.glob('polar_nav_*/setup.py')))
PROGRAMS = {
    **NODES,
    'polar_nav_ros': NODES['polar_nav_ros'] | {'composed'},
    'polar_nav_tools': NODES['polar_nav_tools'] | {'polar'},
}

# rosdep keys of what has another name in Python; ROS packages have the same.
KEYS = {
    'jinja2': 'python3-jinja2',
    'hypothesis': 'python3-hypothesis',
    'matplotlib': 'python3-matplotlib',
    'mcap': 'mcap-ros2-support',
    'mcap_ros2': 'mcap-ros2-support',
    'lz4': 'mcap-ros2-support',
    'zstandard': 'mcap-ros2-support',
    'numba': 'python3-numba',
    'numpy': 'python3-numpy',
    'psutil': 'python3-psutil',
    'pyproj': 'python3-pyproj',
    'pytest': 'python3-pytest',
    'rich': 'python3-rich',
    'rosbags': 'python3-rosbags-pip',
    'ruamel': 'python3-ruamel.yaml',
    'scipy': 'python3-scipy',
    'typer': 'python3-typer',
    'yaml': 'python3-yaml',
}
# What a package starts or reads without importing it.
STARTED = {
    'polar_nav_follower': {'ros2launch'},
    'polar_nav_leader': {'ros2launch'},
    'polar_nav_tools': {'polar_nav_follower', 'polar_nav_leader', 'polar_nav_sim', 'ros2launch'},
}
# What benchmarks and tests compare with: imported where it is used, and not needed to run.
COMPARED = {
    'avar', 'boto3', 'evo', 'filterpy', 'gtsam', 'moto', 'pandas', 'pyins', 's3fs', 'stonesoup',
}  # fmt: skip
# The README says how to get gsw, pygeomag and what experiments and campaigns run on, which have no
# rosdep key; isal is used where it is there; the others come with numba, typer, jinja2.
WITHOUT_KEY = {
    'click', 'dask', 'distributed', 'distutils', 'fsspec', 'gsw', 'isal', 'llvmlite', 'markupsafe',
    'msgspec', 'pyarrow', 'pygeomag', 'setuptools',
}  # fmt: skip


def imported(folder: Path) -> set[str]:
    """Top-level names that the modules below ``folder`` import, wherever in the file."""
    names: set[str] = set()
    for file in folder.rglob('*.py'):
        for node in ast.walk(ast.parse(file.read_text(), str(file))):
            if isinstance(node, ast.Import):
                names |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names.add(node.module.split('.')[0])
    return names - set(sys.stdlib_module_names) - WITHOUT_KEY - COMPARED


def declared(package: str, *tags: str) -> set[str]:
    root = ElementTree.parse(ROOT / package / 'package.xml').getroot()
    return {(e.text or '').strip() for tag in tags for e in root.iter(tag)}


def used(package: str) -> set[str]:
    """Keys of all that runs with a package."""
    names = imported(ROOT / package / package) | imported(ROOT / package / 'launch')
    return {KEYS.get(name, name) for name in names - {package}} | STARTED.get(package, set())


def used_by_tests(package: str) -> set[str]:
    # Some use the core's helpers, too (conftest.py).
    folders = (ROOT / package / 'test', ROOT / 'polar_nav_core' / 'test')
    helpers = {entry.stem for folder in folders for entry in folder.iterdir()}
    names = imported(ROOT / package / 'test') - helpers - {package}
    return {KEYS.get(name, name) for name in names}


@pytest.mark.slow
@pytest.mark.parametrize('package', PACKAGES)
def test_package_xml_names_every_import_and_nothing_else(package):
    assert declared(package, 'exec_depend', 'depend') == used(package)


@pytest.mark.parametrize('package', PACKAGES)
def test_package_xml_names_every_import_of_the_tests(package):
    known = declared(package, 'exec_depend', 'depend', 'test_depend')
    assert used_by_tests(package) <= known


def test_entry_points_are_the_nodes_of_the_design():
    for package, names in PROGRAMS.items():
        text = (ROOT / package / 'setup.cfg').read_text()
        assert set(re.findall(r'^ +(\w+) = .*:main$', text, re.MULTILINE)) == names


@pytest.fixture(scope='session')
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with build/ and install/ of ``colcon build``, as a user calls it in ros2_ws."""
    prefix = Path(sys.prefix)
    if not (prefix / 'bin/colcon').exists():
        pytest.skip('no colcon in this environment')
    base = tmp_path_factory.mktemp('ros2_ws')
    installed = snapshot(prefix)
    bases = [f'--build-base={base / "build"}', f'--install-base={base / "install"}']
    result = subprocess.run(
        [prefix / 'bin/colcon', f'--log-base={base / "log"}', 'build', *bases],
        cwd=ROOT / 'ros2_ws',
        env=outside(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert result.returncode == 0, result.stdout[-5000:]
    assert '7 packages finished' in result.stdout
    assert snapshot(prefix) == installed, 'the build changed the environment'
    return base


def snapshot(prefix: Path) -> dict[Path, tuple[int, int]]:
    """Size and time of every CMake file and library that a build could be tempted to patch."""
    files: Iterator[Path] = (p for p in (prefix / 'share').rglob('*.cmake'))
    libraries = (prefix / 'lib').glob('*.so*')
    return {p: (p.stat().st_size, p.stat().st_mtime_ns) for p in (*files, *libraries)}


def outside() -> dict[str, str]:
    """Environment of a shell in which only the virtual environment was activated."""
    keep = {k: v for k, v in os.environ.items() if k in ('HOME', 'LANG', 'TMPDIR', 'CC', 'CXX')}
    if shutil.which('make') is None:  # CMake's default; ninja comes with the environment
        keep['CMAKE_GENERATOR'] = 'Ninja'
    return {
        **keep,
        'PATH': f'{sys.prefix}/bin:/usr/local/bin:/usr/bin:/bin',
        'ROS_DOMAIN_ID': '37',
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }


def sourced(workspace: Path, command: str) -> list[str]:
    return ['bash', '-c', f'source {workspace}/install/setup.bash && exec {command}']


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize('package', PACKAGES)
def test_colcon_installs_all_that_belongs_to_a_package(workspace, package):
    install = workspace / 'install' / package
    share = install / 'share' / package
    assert (share / 'package.xml').is_file()
    assert (install / 'share/ament_index/resource_index/packages' / package).is_file()
    programs = {p.name for p in (install / 'lib' / package).glob('*') if os.access(p, os.X_OK)}
    assert programs == PROGRAMS.get(package, set())
    (site,) = install.glob('lib/python3.*/site-packages')
    for file in files(ROOT / package / package):
        assert (site / package / file).is_file(), f'{file} of {package} is not installed'
    for folder in ('config', 'launch', 'missions', 'systemd'):
        for file in files(ROOT / package / folder):
            assert (share / folder / file).is_file(), f'{folder}/{file} is not installed'


def files(folder: Path) -> list[Path]:
    found = (p for p in folder.rglob('*') if p.is_file() and '__pycache__' not in p.parts)
    return sorted(p.relative_to(folder) for p in found)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_after_sourcing_the_built_packages_are_used(workspace):
    names = (*PACKAGES, 'polar_nav_msgs')
    code = f'import {", ".join(names)}; print(*(m.__file__ for m in ({", ".join(names)})))'
    result = subprocess.run(
        sourced(workspace, f'python -c "{code}"'),
        env=outside(),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    for place in result.stdout.split():
        assert place.startswith(str(workspace / 'install'))


@pytest.fixture(scope='module')
def ended(workspace, tmp_path_factory) -> dict[str, tuple[bool, int, str]]:
    """Of each node of the build: whether it appeared, its status after SIGINT, what it said."""
    folder = tmp_path_factory.mktemp('nodes')
    # It carries nothing without a file.
    (folder / 'modem.yaml').write_text('transmit: {topic: t, type: std_msgs/msg/ByteMultiArray}')
    shell = subprocess.run(
        sourced(workspace, 'env -0'), env=outside(), stdout=subprocess.PIPE, check=True
    )
    env = dict(line.split('=', 1) for line in shell.stdout.decode().split('\0') if line)
    running: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for package, nodes in NODES.items():
            for node in sorted(nodes):
                program = workspace / 'install' / package / 'lib' / package / node
                options = ['--ros-args', '-r', '__ns:=/probe']
                if node == 'modem_bridge':
                    options += ['-p', 'modem:=modem.yaml']
                with (folder / node).open('wb') as log:
                    running[node] = subprocess.Popen(
                        [program, *options], env=env, cwd=folder, stdout=log, stderr=log
                    )
        seen = appeared({f'/probe/{node}' for node in running})
        for process in running.values():
            process.send_signal(signal.SIGINT)
        # A first start compiles the filter before it looks at anything else.
        status = {node: process.wait(900.0) for node, process in running.items()}
    finally:
        for process in running.values():
            process.kill()
            process.wait()
    return {
        node: (f'/probe/{node}' in seen, status[node], (folder / node).read_text())
        for node in running
    }


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.timeout(1200)
@pytest.mark.parametrize('node', sorted({node for nodes in NODES.values() for node in nodes}))
def test_a_node_of_the_build_runs_and_ends_cleanly(ended, node):
    seen, status, said = ended[node]
    assert seen, f'{node} did not appear: {said}'
    assert status == 0, said


def appeared(names: set[str]) -> set[str]:
    """Watch the ROS graph, from another process, until nodes are there; those that are."""
    code = (
        'import rclpy, sys, time\n'
        'rclpy.init()\n'
        'node = rclpy.create_node("watcher")\n'
        'limit = time.monotonic() + 120.0\n'
        'wanted, seen = set(sys.argv[1:]), set()\n'
        'while not wanted <= seen and time.monotonic() < limit:\n'
        '    time.sleep(0.1)\n'
        '    found = node.get_node_names_and_namespaces()\n'
        '    seen |= {ns.rstrip("/") + "/" + n for n, ns in found}\n'
        'print(*(wanted & seen))\n'
    )
    watcher = [sys.executable, '-c', code, *names]
    done = subprocess.run(watcher, env=outside(), stdout=subprocess.PIPE, text=True, check=True)
    return set(done.stdout.split())
