"""One core for all timed work, and a description of the machine.

Imports nothing numerical: linear algebra libraries choose their number of threads when they are
loaded, so that the process has to be on its core before.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib import metadata

from polar_nav_core.errors import ConfigError

from ..live.run_info import cpu_model


def pin(core: int | None = None) -> int:
    """Number of the core to which this process is bound, by default the last allowed one.

    Raises
    ------
    ConfigError
        For a core that this process may not use.
    """
    allowed = sorted(os.sched_getaffinity(0))
    chosen = allowed[-1] if core is None else core
    if chosen not in allowed:
        raise ConfigError(f'core {chosen} is none of those this process may use: {allowed}')
    os.sched_setaffinity(0, {chosen})
    os.environ['OPENBLAS_NUM_THREADS'] = '1'
    return chosen


def describe(distributions: Sequence[str]) -> dict[str, object]:
    """Description of the machine: CPU model, cores, load average of the last minute, versions."""
    return {
        'cpu': cpu_model(),
        'cores': os.cpu_count(),
        'load_average': load(),
        'python': platform.python_version(),
        'versions': versions(distributions),
    }


def load() -> float:
    """Load average of the last minute."""
    return os.getloadavg()[0]


def versions(distributions: Sequence[str]) -> dict[str, str]:
    """Versions of those of these distributions that are installed."""
    found = {}
    for name in distributions:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
