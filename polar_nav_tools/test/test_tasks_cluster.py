"""Tasks in other processes: workers and clients that are killed, schedulers somewhere else."""

import logging
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import dask
import distributed
import psutil
import pyarrow.parquet as pq
import pytest
from distributed.client import FutureCancelledError
from task_samples import Sum, tasks_of, walk

from polar_nav_core.errors import ConfigError, PolarNavError
from polar_nav_tools.tasks import attempt as attempt_module
from polar_nav_tools.tasks import cluster, distribution
from polar_nav_tools.tasks.attempt import DifferentWorker, attempt
from polar_nav_tools.tasks.distribution import Distribution, EndedWorkers, Unreachable
from polar_nav_tools.tasks.execution import Workers, execute
from polar_nav_tools.tasks.rows import FAILED, VARYING
from polar_nav_tools.tasks.store import opened

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

HERE = Path(__file__).parent
JOBS = [Sum(seed) for seed in range(40)]


@pytest.fixture(scope='module')
def client():
    """Client of two workers of this machine, for all tests."""
    with cluster.local(2) as found:
        yield found


def test_processes_that_end_late_do_not_undo_what_is_done(monkeypatch):
    """A machine that is busy with other work: Dask waits for them no longer than it is told to."""
    from distributed import LocalCluster

    close = LocalCluster.close

    def late(self, timeout=None):
        close(self)
        raise TimeoutError(f'timed out after {timeout} s.')

    monkeypatch.setattr(LocalCluster, 'close', late)
    with cluster.local(1) as found:
        assert found.submit(sum, [1, 2]).result() == 3


def test_threads_that_outlive_a_cluster_say_nothing_on_the_terminal():
    """They are still at the connections of workers that an interrupt killed."""
    from distributed.batched import logger

    logging.getLogger('distributed').setLevel(logging.INFO)  # as Dask itself sets it
    assert logger.isEnabledFor(logging.INFO)
    with pytest.raises(KeyboardInterrupt), cluster.local(1):
        raise KeyboardInterrupt
    assert not logger.isEnabledFor(logging.ERROR)


def test_a_worker_that_dask_gives_up_is_replaced():
    """Dask does not start a process again that was killed before it had quite begun."""
    with (
        dask.config.set({'distributed.deploy.lost-worker-timeout': '100 ms'}),
        cluster.local(1) as c,
    ):
        (given_up,) = c.cluster.workers.values()
        before = c.submit(os.getpid).result()
        c.sync(given_up.close)
        assert c.submit(os.getpid, pure=False).result(timeout=120) != before


def by(client, folder, tasks, *, failures=False):
    """Rows of tasks done by the workers of a client, as a finished file."""
    with opened(folder) as store:
        for found in Distribution(client, tasks, walk).attempts():
            store.add([a.row for a in found if failures or a.error is None])
        store.finish([t.key for t in tasks])
    return table(folder)


def table(folder):
    """Rows of a folder without what may differ between equal tasks."""
    return pq.read_table(folder / 'rows.parquet').drop_columns(list(VARYING))


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp('undisturbed')
    tasks = tasks_of(JOBS)
    with opened(folder) as store:
        execute(tasks, walk, store, Workers(1), lambda *_: None)
        store.finish([t.key for t in tasks])
    return table(folder)


def wait_until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_rows_of_two_workers_are_those_of_this_process(client, undisturbed, tmp_path):
    assert by(client, tmp_path / 'a', tasks_of(JOBS)).equals(undisturbed)
    backwards = tasks_of(JOBS[::-1], stretch=7)
    assert by(client, tmp_path / 'b', backwards).take(list(range(39, -1, -1))).equals(undisturbed)


def test_what_the_client_keeps_of_the_scheduler_hides_no_worker(
    client, undisturbed, tmp_path, monkeypatch
):
    """It asks for totals every two seconds, and has them where the last answer was."""
    monkeypatch.setattr(client._periodic_callbacks['scheduler-info'], 'callback_time', 1.0)
    monkeypatch.setattr(distribution, '_LOOK_S', 0.02)
    sync, submit, given = client.sync, client.submit, []

    def on_a_busy_machine(*arguments, **options):
        found = sync(*arguments, **options)
        time.sleep(0.02)
        return found

    def counted(*arguments, **options):
        given.append(arguments)
        return submit(*arguments, **options)

    monkeypatch.setattr(client, 'sync', on_a_busy_machine)
    monkeypatch.setattr(client, 'submit', counted)
    assert by(client, tmp_path / 'rows', tasks_of(JOBS)).equals(undisturbed)
    assert len(given) == len(JOBS)  # none twice


@pytest.mark.parametrize('error', [distributed.TimeoutError, UnboundLocalError])
def test_a_result_that_takes_its_time_is_asked_for_again(
    client, undisturbed, tmp_path, monkeypatch, error
):
    """A busy machine: Dask says so, or that its `sync` has neither result nor error."""
    result, asked = distributed.Future.result, set()

    def late_at_first(future, timeout=None):
        if future.key not in asked:
            asked.add(future.key)
            raise error('late')
        return result(future, timeout)

    monkeypatch.setattr(distributed.Future, 'result', late_at_first)
    assert by(client, tmp_path / 'rows', tasks_of(JOBS)).equals(undisturbed)
    assert len(asked) == len(JOBS)


def test_a_result_that_is_cancelled_as_it_is_asked_for_tells_of_the_scheduler(
    client, tmp_path, monkeypatch
):
    """Dask cancels all results once the scheduler is gone, at any moment."""

    def cancelled(future, **_):
        raise FutureCancelledError(future.key, 'lost connection to the scheduler')

    monkeypatch.setattr(distributed.Future, 'result', cancelled)
    with pytest.raises(Unreachable, match='--resume'):
        by(client, tmp_path / 'rows', tasks_of(JOBS))


def test_a_killed_worker_loses_nothing(client, undisturbed, tmp_path):
    jobs = [Sum(s, ends=str(tmp_path / f'{s}') if s in (3, 20) else '') for s in range(40)]
    assert by(client, tmp_path / 'rows', tasks_of(jobs)).equals(undisturbed)
    assert (tmp_path / '3').exists()
    assert (tmp_path / '20').exists()


def test_what_kills_every_worker_is_a_failure(client, undisturbed, tmp_path):
    jobs = [*JOBS[:4], Sum(4, always=True, ends=str(tmp_path / 'mark')), *JOBS[5:]]
    found = by(client, tmp_path / 'rows', tasks_of(jobs), failures=True)
    assert found['status'].to_pylist().count(FAILED) == 1
    reason = found['reason'][4].as_py()
    assert reason.startswith('EndedWorkers: scale 1')
    assert 'ended 3 workers' in reason
    assert issubclass(EndedWorkers, PolarNavError)  # a command ends with this sentence
    others = [i for i in range(40) if i != 4]
    names = undisturbed.column_names
    assert found.select(names).take(others).equals(undisturbed.take(others))


def test_failures_come_back_with_their_error(client):
    tasks = tasks_of([Sum(0), Sum(1, fails=True), Sum(2)])
    found = [a for some in Distribution(client, tasks, walk).attempts() for a in some]
    (error,) = [a.error for a in found if a.error is not None]
    assert isinstance(error, ValueError)
    assert 'task_samples.py' in error.__notes__[0]


def test_an_error_leaves_the_finished_and_no_task_behind(client):
    class Gone(Exception):
        pass

    def first_only():
        for found in Distribution(client, tasks_of(JOBS), walk).attempts():
            raise Gone(found)

    with pytest.raises(Gone):
        first_only()
    wait_until(lambda: not any(client.processing().values()))


@pytest.mark.usefixtures('client')
def test_a_cluster_listens_on_the_loopback_interface_only():
    # Of this process and all that it started: none of them is anybody else's.
    family = [psutil.Process(), *psutil.Process().children(recursive=True)]
    listening = [
        c.laddr.ip for p in family for c in p.net_connections() if c.status == psutil.CONN_LISTEN
    ]
    assert listening
    assert set(listening) == {'127.0.0.1'}


def test_a_worker_of_another_engine_is_refused(monkeypatch):
    monkeypatch.setattr(attempt_module, 'ENGINE_VERSION', 1000)
    with pytest.raises(DifferentWorker, match='engine 1000'):
        attempt(walk, tasks_of([Sum(1)])[0])


CLIENT = """
import sys
from pathlib import Path
from task_samples import Sum, tasks_of, walk
from polar_nav_tools.tasks.execution import Workers, execute
from polar_nav_tools.tasks.store import opened
if __name__ == '__main__':
    tasks = tasks_of([Sum(s, log=sys.argv[2]) for s in range(int(sys.argv[3]))])
    with opened(Path(sys.argv[1])) as store:
        execute(tasks, walk, store, Workers(2), lambda *_: None)
"""


def test_a_killed_client_loses_nothing_and_leaves_nobody(tmp_path, undisturbed):
    (tmp_path / 'client.py').write_text(CLIENT)
    rows, log = tmp_path / 'rows', tmp_path / 'log'
    # So many that it cannot be through by the time it is killed: its rows are counted from 5 on.
    command = [sys.executable, tmp_path / 'client.py', rows, log, '100000']
    with subprocess.Popen(command, env=environment()) as ran:
        try:
            wait_until(lambda: len(list((rows / 'rows.parts').glob('*.parquet'))) >= 5)
            family = psutil.Process(ran.pid).children(recursive=True)
        finally:
            ran.send_signal(signal.SIGKILL)
    wait_until(lambda: not any(p.is_running() and p.status() != 'zombie' for p in family))
    tasks = tasks_of(JOBS)
    more = tmp_path / 'more'
    counted = tasks_of([Sum(s, log=str(more)) for s in range(40)])
    with opened(rows) as store:
        there = {t.key for t in tasks} & set(store.rows)
        assert len(there) >= 5
        execute(counted, walk, store, Workers(1), lambda *_: None)
        assert len(more.read_text().split()) == 40 - len(there) if len(there) < 40 else True
        store.finish([t.key for t in tasks])
    assert table(rows).slice(0, 40).select(undisturbed.column_names).equals(undisturbed)


def environment():
    paths = [str(HERE), *filter(None, [os.environ.get('PYTHONPATH')])]
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(paths)}


@contextmanager
def started(folder, *arguments):
    """Process of Dask's own command in another folder."""
    folder.mkdir()
    with (folder / 'log').open('w') as log:
        ran = subprocess.Popen(
            [sys.executable, '-m', 'dask', *arguments],
            cwd=folder,
            env=environment(),
            stdout=log,
            stderr=log,
        )
        try:
            yield folder / 'log'
        finally:
            ran.kill()
            ran.wait()


@contextmanager
def elsewhere(tmp_path, workers):
    """Address of a scheduler with workers, each a process of its own in a folder of its own."""
    with ExitStack() as stack:
        bare = ('--host', '127.0.0.1', '--no-dashboard')
        log = stack.enter_context(
            started(tmp_path / 'scheduler', 'scheduler', *bare, '--port', '0')
        )
        wait_until(lambda: re.search(r'Scheduler at: +(tcp://\S+)', log.read_text()))
        address = re.search(r'Scheduler at: +(tcp://\S+)', log.read_text())[1]
        for i in range(workers):
            options = ('worker', address, '--nthreads', '2', *bare)
            stack.enter_context(started(tmp_path / f'worker{i}', *options))
        yield address


def test_a_scheduler_somewhere_gives_the_same_rows(undisturbed, tmp_path):
    tasks = tasks_of(JOBS)
    with elsewhere(tmp_path, 2) as address, opened(tmp_path / 'rows') as store:
        execute(tasks, walk, store, Workers(1, address), lambda *_: None)
        store.finish([t.key for t in tasks])
    assert table(tmp_path / 'rows').equals(undisturbed)


def test_a_scheduler_that_ends_leaves_what_was_finished(tmp_path):
    def then_end_it(done, _total, _failed):
        if done == 10:
            os.kill(scheduler, signal.SIGKILL)

    with elsewhere(tmp_path, 1) as address, opened(tmp_path / 'rows') as store:
        port = int(address.rsplit(':', 1)[1])
        listening = [c for c in psutil.net_connections() if c.status == psutil.CONN_LISTEN]
        (scheduler,) = {c.pid for c in listening if c.laddr.port == port}
        with pytest.raises(Unreachable, match='--resume'):
            execute(
                tasks_of([Sum(s) for s in range(10_000)]),
                walk,
                store,
                Workers(1, address),
                then_end_it,
            )
        assert len(store.rows) >= 10


def test_a_scheduler_without_workers_is_waited_for(tmp_path):
    told = []

    def waiting():
        told.append('waiting')
        raise KeyboardInterrupt

    with (
        elsewhere(tmp_path, 0) as address,
        opened(tmp_path / 'rows') as store,
        pytest.raises(KeyboardInterrupt),
    ):
        execute(tasks_of(JOBS), walk, store, Workers(1, address), lambda *_: None, waiting=waiting)
    assert told == ['waiting']


def test_an_address_without_a_scheduler_is_named(monkeypatch):
    monkeypatch.setattr(cluster, '_CONNECT_S', 0.5)
    for address in ('tcp://127.0.0.1:1', 'nonsense://here'):
        with (
            pytest.raises(ConfigError, match=f'--scheduler {address}'),
            cluster.connected(address),
        ):
            pass
