"""The real `ros2` command of this machine, run by the Python and with the packages of `.venv`.

ros2cli and launch are pure Python and in no wheel: they come from ROS 2 as the system or another
workspace has it. Middleware, messages and nodes stay those of the environment, which comes first
wherever something is looked for.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from pathlib import Path

from polar_nav_core.errors import PolarNavError

APT = Path('/opt/ros/jazzy/bin/ros2')
PROGRAM = 'POLAR_ROS2'
"""Variable that names another `ros2`."""
MISSING = (
    'there is no ros2 command on this machine: neither on the PATH nor under /opt/ros/jazzy. It '
    'is in no index of Python packages: the wheels of .venv have no ros2cli and no launch. On '
    'Ubuntu 24.04 with the apt repository of ROS 2: '
    '`sudo apt install ros-jazzy-ros2cli-common-extensions` (or of these ros-jazzy-ros2cli, '
    'ros-jazzy-ros2run, ros-jazzy-ros2launch, ros-jazzy-ros2topic and what else is wanted); then '
    'call this again, nothing has to be sourced'
)
_RUN = 'import sys; sys.argv[0] = "ros2"; from ros2cli.cli import main; sys.exit(main())'
_PACKAGES = re.compile(r'/(site|dist)-packages$')
_ASK = 'import sys; print("\\n".join(sys.path))'


class NoRos2Error(PolarNavError):
    """There is no `ros2` that could be run."""


def find_ros2(env: Mapping[str, str], apt: Path = APT) -> Path:
    """Program `ros2`: named by the environment, on the PATH outside of `.venv`, or of apt.

    Raises
    ------
    NoRos2Error
        With what has to be installed.
    """
    outside = [
        folder
        for folder in env.get('PATH', '').split(os.pathsep)
        if folder and Path(folder).resolve() != Path(sys.prefix, 'bin').resolve()
    ]
    named = env.get(PROGRAM) or shutil.which('ros2', path=os.pathsep.join(outside))
    if named or apt.is_file():
        return Path(named or apt)
    raise NoRos2Error(MISSING)


def surroundings(program: Path, env: Mapping[str, str]) -> dict[str, str]:
    """Environment in which the Python of `.venv` finds the packages of a `ros2`, after its own.

    Raises
    ------
    NoRos2Error
        For a program without the package ros2cli beside it.
    """
    prefix = program.resolve().parent.parent
    beside = sorted(prefix.glob('lib/python3*/site-packages'))
    beside += [folder for folder in _of_python(program) if folder not in beside]
    if not any((folder / 'ros2cli').is_dir() for folder in beside):
        raise NoRos2Error(f'{program}: there is no package ros2cli beside it')
    own = [*env.get('PYTHONPATH', '').split(os.pathsep), sysconfig.get_path('purelib')]
    return {
        **env,
        'PYTHONPATH': _joined([*own, *map(str, beside)]),
        'AMENT_PREFIX_PATH': _joined(
            [*env.get('AMENT_PREFIX_PATH', '').split(os.pathsep), str(prefix)]
        ),
    }


def command(arguments: Sequence[str]) -> list[str]:
    """Command line of `ros2` with arguments, for the Python of `.venv`."""
    return [sys.executable, '-P', '-c', _RUN, *arguments]


def _of_python(program: Path) -> list[Path]:
    """Folders of packages of the Python that a script names in its first line."""
    try:
        with program.open('rb') as file:
            first = file.readline(4096).decode()
        if not first.startswith('#!'):
            return []
        python = [*first[2:].split(), '-c', _ASK]
        done = subprocess.run(python, capture_output=True, text=True, timeout=20.0, check=True)
    except (OSError, UnicodeDecodeError, subprocess.SubprocessError):
        return []
    return [Path(line) for line in done.stdout.splitlines() if _PACKAGES.search(line)]


def _joined(folders: Sequence[str]) -> str:
    return os.pathsep.join(dict.fromkeys(folder for folder in folders if folder))
