"""One core for everything that is timed, and what the machine is.

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
    """Bind this process to one core, the last of those it may use by default; its number.

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
    """CPU model, cores, load average of the last minute, versions."""
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
    """Versions of what is installed of these."""
    found = {}
    for name in distributions:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
