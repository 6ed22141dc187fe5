"""Description of a run for its bag: mission, seeds, versions, commit, machine.

Together with the parameters that every node publishes on /run_info it is what somebody needs to
make the run again.
"""

from __future__ import annotations

import hashlib
import platform
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polar_nav_core.engine.version import ENGINE_VERSION

if TYPE_CHECKING:
    from polar_nav_sim.mission import Mission

    from ..graph.build import Graph
    from ..graph.options import GraphOptions

_DISTRIBUTIONS = ('numpy', 'scipy', 'numba', 'gsw', 'mcap', 'ros-rclpy', 'ros-rmw-fastrtps-cpp')
_SOURCES = Path(__file__).resolve().parents[3]
_CPUINFO = Path('/proc/cpuinfo')


def run_info(mission: Mission, options: GraphOptions, graph: Graph) -> dict[str, Any]:
    """Description of a run in values for JSON."""
    return {
        'mission': mission.name,
        'description': mission.description,
        'mission_file': str(mission.file),
        'mission_document': dict(mission.document),
        'duration_s': mission.duration_s,
        'seed': options.seed,
        'pace': options.pace,
        'configuration': options.configuration,
        'leader': options.leader,
        'composed': options.composed,
        'nodes': [spec.full_name for spec in graph.nodes],
        'engine_version': ENGINE_VERSION,
        'versions': versions(),
        'git_commit': git_commit(_SOURCES),
        'requirements_lock_sha256': lock_sha256(),
        'python': platform.python_version(),
        'platform': platform.platform(),
        'cpu': cpu_model(),
        'command': sys.argv[1:],
    }


def versions() -> dict[str, str]:
    """Versions of installed distributions that the numbers depend on."""
    found = {}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def git_commit(folder: Path) -> str:
    """Commit hash of the sources, ``-dirty`` if files differ; empty outside of a clone."""
    if not (folder / '.git').exists():
        return ''
    command = ['git', '-C', str(folder), 'describe', '--always', '--dirty', '--abbrev=40']
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return ''  # no git on this machine, or no commit yet
    return found.stdout.strip()


def cpu_model() -> str:
    """Name of the processor; replays are equal bit for bit on one model.

    Linux names a processor of x86-64, and numbers designer and part of one of Arm.
    """
    known = _cpuinfo()
    machine = platform.machine()
    name = known.get('model name') or _numbers(known, 'CPU implementer', 'CPU part')
    if not name:
        return machine
    return name if machine == 'x86_64' else f'{machine} {name}'  # an emulator shows its host's


def cpu_identity() -> str:
    """Name of the processor with family, model and stepping, which differ between generations."""
    details = _numbers(
        _cpuinfo(), 'cpu family', 'model', 'stepping', 'CPU variant', 'CPU revision'
    )
    return f'{cpu_model()} ({details})' if details else cpu_model()


def _cpuinfo() -> dict[str, str]:
    """What Linux says of the processor; cores of several kinds in the order of their numbers."""
    found: dict[str, list[str]] = {}
    if _CPUINFO.is_file():
        for line in _CPUINFO.read_text(encoding='utf-8', errors='replace').splitlines():
            name, _, value = line.partition(':')
            values = found.setdefault(name.strip(), [])
            if value.strip() not in values:
                values.append(value.strip())
    return {name: ' and '.join(values) for name, values in found.items()}


def _numbers(known: dict[str, str], *names: str) -> str:
    return ', '.join(f'{name} {known[name]}' for name in names if known.get(name))


def lock_sha256() -> str:
    """SHA-256 of the lock file of requirements; empty outside of a clone."""
    path = _SOURCES / 'requirements.lock'
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ''
