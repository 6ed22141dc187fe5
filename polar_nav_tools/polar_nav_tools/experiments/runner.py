"""Results of jobs run in parallel processes, which Ctrl-C ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import Any

from .jobs import RunResult, run_job

Update = Callable[[float, float], None]
RunJob = Callable[[Any], RunResult]


def default_workers() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0))


def run_jobs(
    jobs: Sequence[Any], workers: int, update: Update, run: RunJob = run_job
) -> list[RunResult]:
    """Results of all jobs, in their order.

    Parameters
    ----------
    jobs : sequence
        Jobs in one world should follow one another: a process keeps its last world.
    workers : int
        Processes; with 1 everything runs in this one.
    update : callable
        Called with the number of finished jobs and the total.
    run : callable
        Runs one job; a function of a module.
    """
    total = float(len(jobs))
    update(0.0, total)
    if workers == 1 or len(jobs) < 2:
        results = []
        for done, job in enumerate(jobs, start=1):
            results.append(run(job))
            update(float(done), total)
        return results
    with _one_thread_each():
        return _in_processes(jobs, min(workers, len(jobs)), update, run)


def _in_processes(
    jobs: Sequence[Any], workers: int, update: Update, run: RunJob
) -> list[RunResult]:
    total = float(len(jobs))
    found: dict[int, RunResult] = {}
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context('spawn')
    executor = ProcessPoolExecutor(workers, context, _start_worker)
    try:
        futures = {executor.submit(run, job): i for i, job in enumerate(jobs)}
        for future in as_completed(futures):
            found[futures[future]] = future.result()
            update(float(len(found)), total)
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    executor.shutdown()
    return [found[i] for i in range(len(jobs))]


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Set one thread of linear algebra for processes started here: small matrices, many runs."""
    name = 'OPENBLAS_NUM_THREADS'
    before = os.environ.get(name)
    os.environ[name] = '1'
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def _start_worker() -> None:
    """Make a worker end at once at Ctrl-C, without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
