"""Dask clusters: one of this machine's processes, or any that listens somewhere."""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from polar_nav_core.errors import ConfigError

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

    from distributed import Client, LocalCluster

LOOPBACK = '127.0.0.1'
_CONNECT_S = 30.0
_LOOK_S = 1.0


def default_workers() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0))


@contextmanager
def local(workers: int) -> Iterator[Client]:
    """Client of a cluster of processes of this machine, which end with the block, however it ends.

    It listens on the loopback interface only and shows no pages. A process that dies is started
    again.
    """
    import dask
    from distributed import Client, LocalCluster

    _silence()
    quiet = {'dashboard': False, 'dashboard_address': f'{LOOPBACK}:0'}
    others = set(multiprocessing.active_children())
    with (
        tempfile.TemporaryDirectory(prefix='polar-tasks-', ignore_cleanup_errors=True) as scratch,
        dask.config.set(
            {
                'distributed.scheduler.http.routes': [],
                'distributed.worker.http.routes': [],
                'distributed.admin.log-length': 0,
                'distributed.worker.profile.enabled': False,
                # Its nanny notices one that ends; one that is silent on a busy machine lives.
                'distributed.scheduler.worker-ttl': None,
                'distributed.comm.timeouts.tcp': '10 minutes',
                'distributed.comm.timeouts.connect': '2 minutes',
                # Dask's own gives every freed array back to the system, which the next one asks
                # for again.
                'distributed.nanny.pre-spawn-environ': {'OPENBLAS_NUM_THREADS': 1},
            }
        ),
    ):
        with _interrupts_kept() as interrupts:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host=LOOPBACK,
                dashboard_address=None,
                scheduler_kwargs=quiet,
                silence_logs=logging.CRITICAL,
                local_directory=scratch,
            )
        try:
            if interrupts:
                raise KeyboardInterrupt
            with Client(cluster, set_as_default=False) as client:
                replacing = asyncio.run_coroutine_threadsafe(
                    _replace_ended(cluster, workers), cluster.loop.asyncio_loop
                )
                try:
                    yield client
                finally:
                    replacing.cancel()
        except BaseException:
            # Whoever interrupts does not wait for the runs that are under way.
            _kill_all_but(others)
            raise
        finally:
            # On a machine that is busy with other work processes may end later; what they were
            # for is done.
            try:
                cluster.close(timeout=5.0)
            except TimeoutError:
                _kill_all_but(others)


async def _replace_ended(cluster: LocalCluster, workers: int) -> None:
    """Start those anew whose nanny has given up, again and again until it is cancelled.

    It does where its process is killed before it has quite begun, which takes long on a busy
    machine: with all of them gone a campaign would wait for ever.
    """
    while True:
        await asyncio.sleep(_LOOK_S)
        if len(cluster.workers) < workers:
            cluster.scale(workers)


def _silence() -> None:
    """Let Dask say nothing on the terminal for the rest of this process.

    What a cluster silences itself it says again once it is closed, while its threads are still at
    the connections of workers that were killed.
    """
    for name in ('distributed', 'distributed.client', 'distributed.gc'):
        logging.getLogger(name).setLevel(logging.CRITICAL)


def _kill_all_but(others: set[BaseProcess]) -> None:
    for process in set(multiprocessing.active_children()) - others:
        process.kill()


@contextmanager
def _interrupts_kept() -> Iterator[list[int]]:
    """Keep interrupts for later: a cluster that is half made cannot be closed."""
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield came
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def connected(address: str) -> Iterator[Client]:
    """Client of a scheduler somewhere, which stays as it is.

    Raises
    ------
    ConfigError
        If none answers there.
    """
    from distributed import Client

    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f'--scheduler {address}: no Dask scheduler answers there') from error
    with client:
        yield client
