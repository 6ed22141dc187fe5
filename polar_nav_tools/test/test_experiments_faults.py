"""Verdicts of the experiment `faults` on made-up runs, and a few real ones."""

import math

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.hold.drive import Trace, Word
from polar_nav_tools.experiments.hold.judge import Errors, first_new, judge
from polar_nav_tools.experiments.hold.plan import COLUMNS, FAULTS, plan, run_job
from polar_nav_tools.experiments.hold.rows import ROWS, rows_named
from polar_nav_tools.experiments.hold.table import tables
from polar_nav_tools.experiments.request import Request, Size

START_S, END_S, UNTIL_S = 100.0, 110.0, 300.0
TIMES = np.arange(1.0, UNTIL_S + 1.0)
FIXES = np.arange(2.0, UNTIL_S, 2.0)
WARNED = (Word(101.0, 1, 'DVL silent for 1 s'),)


def errors(off, sigma=1.0, until=UNTIL_S):
    """Errors along x with a sigma, each a number or a function of time."""
    t = TIMES[until >= TIMES]
    x = off(t) if callable(off) else np.full(len(t), off)
    s = sigma(t) if callable(sigma) else np.full(len(t), sigma)
    d = np.zeros((len(t), 3))
    d[:, 0] = x
    return Errors(t, d, np.repeat(np.asarray(s, float)[:, None], 3, axis=1))


def verdict(found, words=WARNED, level=0, ended='', end_s=END_S):
    trace = Trace(
        found.time_s, np.zeros((0, 3)), found.sigma_G, words,
        np.full(int(UNTIL_S), level), FIXES, ended,
    )  # fmt: skip
    return judge(errors(0.5), (), found, trace, START_S, end_s, UNTIL_S)


def between(low, high, value):
    return lambda t: np.where((t >= low) & (t < high), value, 0.5)


def test_recovered_in_time():
    judged = verdict(errors(between(100, 150, 4.0)))
    assert (judged.verdict, judged.recovered_s, judged.worst_m) == ('recovered', 40.0, 4.0)
    assert (judged.reported_s, judged.sentence) == (1.0, 'WARN: DVL silent for 1 s')


def test_not_recovered():
    assert verdict(errors(between(100, 180, 4.0))).verdict == 'NOT RECOVERED'
    assert verdict(errors(between(100, 180, 4.0)), words=()).verdict == 'SILENT'
    assert verdict(errors(between(100, 301, 4.0))).recovered_s == math.inf
    wide = errors(0.5, sigma=lambda t: np.where(t > 100, 3.5, 1.0))
    assert verdict(wide).verdict == 'NOT RECOVERED'
    assert verdict(wide).sigma_ratio == pytest.approx(3.5)


def test_beyond_five_sigma_needs_error():
    off = errors(between(100, 120, 5.5))
    assert verdict(off).verdict == 'SILENT'
    assert verdict(off).unsaid_s == 20.0
    assert verdict(off, level=2).verdict == 'recovered'


def test_dead():
    assert verdict(errors(0.5, until=200.0)).verdict == 'DEAD'
    assert verdict(errors(0.5), ended='no state').verdict == 'DEAD'
    # A sensor that is gone for good leaves nothing to publish; it must be reported.
    assert verdict(errors(0.5, until=200.0), end_s=math.inf).verdict == 'reported'


def test_lasting_fault_is_covered_or_reported():
    assert verdict(errors(3.0), end_s=math.inf).verdict == 'reported'
    assert verdict(errors(3.0), words=(), end_s=math.inf).verdict == 'covered'
    assert verdict(errors(6.0), end_s=math.inf).verdict == 'SILENT'


def test_only_new_words_report():
    before, usual = Word(90.0, 1, 'no fix for 12 s'), Word(200.0, 2, 'depth off by 3 m')
    words = (before, Word(101.0, 1, 'no fix for 14 s'), Word(102.0, 2, 'depth off by 9 m'))
    assert first_new(words, (usual,), START_S) is None
    new = Word(103.0, 1, 'DVL off')
    assert first_new((*words, new), (usual,), START_S) == new
    long_ago = Word(5.0, 1, 'DVL off')
    assert first_new((long_ago, *words, new), (usual,), START_S) == new


def test_rows_and_columns():
    assert len(ROWS) >= 40
    assert [r.name for r in rows_named('imu_2038,clock*')] == [
        'imu_2038', 'clock_step:3600', 'clock_step:-10', 'clock_step:2', 'clock_step:-2',
    ]  # fmt: skip
    with pytest.raises(ConfigError, match='--rows nothing'):
        rows_named('nothing')
    jobs = plan(Request(rows='imu_2038,station/imu_2038'), Size(280.0, 2), COLUMNS)
    assert len(jobs) == 2 * (len(COLUMNS) + 1)
    assert experiment_named('faults') is FAULTS
    with pytest.raises(ConfigError, match='--duration'):
        plan(Request(duration_s=100.0), Size(100.0, 1), COLUMNS)


@pytest.mark.slow
def test_a_few_of_its_runs():
    rows = 'imu_silent:1,imu_2038,imu_force:1e6,dvl_indefinite,packet_indefinite'
    jobs = plan(Request(rows=rows), Size(280.0, 2), ('default', 'modified_akf'))
    results = [run_job(job) for job in jobs]
    assert {r.verdict for r in results} == {'recovered'}
    assert all(r.sentence for r in results)
    assert all(r.metrics['reported_s'] < 5.0 for r in results)
    table, counts = tables(results)
    assert len(table.rows) == 10
    assert counts.rows[0] == {'verdict': 'recovered', 'default': 5, 'modified_akf': 5}


@pytest.mark.slow
def test_a_run_in_station_mode():
    (job,) = plan(Request(rows='station/imu_silent:1'), Size(280.0, 1), ('default',))
    assert run_job(job).verdict in ('recovered', 'reported', 'covered')
