"""Tasks for tests: cheap ones, some that fail, some that end their process; workers load this."""

import os
import signal
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polar_nav_tools.tasks.attempt import Task
from polar_nav_tools.tasks.keys import key_of


@dataclass(frozen=True)
class Sum:
    """What a task does: a random walk of a seed; ``ends`` is a file whose first reader dies."""

    seed: int
    scale: float = 1.0
    fails: bool = False
    ends: str = ''
    always: bool = False
    log: str = ''


@dataclass(frozen=True)
class Walk:
    metrics: Mapping[str, float]
    seconds: float
    reason: str = ''
    names: Mapping[str, int] = field(default_factory=dict)
    series: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)


def walk(job: Sum) -> Walk:
    if job.log:
        with Path(job.log).open('a') as file:
            file.write(f'{job.seed}\n')
    if job.fails:
        raise ValueError(f'seed {job.seed} cannot be walked')
    if job.always or (job.ends and not Path(job.ends).exists()):
        Path(job.ends).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    steps = job.scale * np.random.default_rng(job.seed).standard_normal(50)
    way = np.cumsum(steps)
    return Walk(
        {'end': float(way[-1]), 'most': float(np.abs(way).max())},
        0.001 * job.seed,
        'went too far' if way[-1] > 15.0 else '',
        {'seed': job.seed},
        {'way': way},
    )


def tasks_of(jobs, stretch=2):
    """Tasks; what ends a process and where calls are counted is no part of their content."""
    return [
        Task(key_of('walk', (j.seed, j.scale, j.fails)), {'scale': j.scale}, j, j.seed // stretch)
        for j in jobs
    ]
