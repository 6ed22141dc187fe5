"""Figures of a graph's processes: what is taken when, and ratios. Runs are in the live tests."""

import json
import os

import pytest

pytest.importorskip('rclpy')

from polar_nav_tools.benchmarks import processes
from polar_nav_tools.benchmarks.graph import GraphBenchmark, GraphRun, _Meter

PIDS = {'one': 1, 'two': 2}


def test_figures_of_this_process_are_those_of_python():
    used = os.times()
    assert processes.cpu_s(os.getpid()) == pytest.approx(used.user + used.system, abs=0.05)
    resident_mb = processes.resident_mb(os.getpid())
    assert 1.0 < processes.proportional_mb(os.getpid()) <= resident_mb + 5.0
    before_mb, held = processes.own_mb(os.getpid()), bytearray(b'x') * 50_000_000
    assert processes.own_mb(os.getpid()) - before_mb == pytest.approx(len(held) / 1e6, abs=5.0)


def test_a_meter_keeps_the_first_moment_at_work_and_the_last(monkeypatch):
    cpu_s, times = {1: 10.0, 2: 20.0}, iter((100.0, 101.0, 102.0))
    monkeypatch.setattr(processes, 'cpu_s', lambda pid: cpu_s[pid])
    monkeypatch.setattr(processes, 'proportional_mb', lambda pid: 100.0 * pid)
    meter = _Meter(lambda: next(times))
    meter.take(1.0, 60.0, PIDS)
    assert meter.taken == []
    meter.take(6.0, 60.0, PIDS)
    assert meter.memory_mb != meter.memory_mb
    cpu_s[1] = 15.0
    meter.take(31.0, 60.0, PIDS)
    assert meter.memory_mb == 300.0
    cpu_s[2] = 30.0
    meter.take(60.0, 60.0, PIDS)
    assert meter.taken == [(6.0, 100.0, 30.0), (60.0, 102.0, 45.0)]


def test_a_meter_leaves_a_run_alone_that_is_over(monkeypatch):
    def gone(_pid):
        raise FileNotFoundError

    monkeypatch.setattr(processes, 'cpu_s', gone)
    meter = _Meter()
    meter.take(60.0, 60.0, PIDS)
    assert meter.taken == []


def test_ratios_are_of_one_round_and_all_is_plain():
    runs = {
        'separate': [GraphRun(13, 200.0, 90.0, 20.0, 10.0, 1200.0), GraphRun(13, *[100.0] * 5)],
        'composed': [GraphRun(5, 100.0, 45.0, 10.0, 5.0, 600.0), GraphRun(5, *[100.0] * 5)],
    }
    found = GraphBenchmark(60.0, runs)
    ratio = found.ratio('cpu_ms')
    assert (ratio.median, ratio.lowest, ratio.highest) == (1.5, 1.0, 2.0)
    rows = {row['what']: row for row in found.table().rows}
    assert rows['processes']['ratio'] == 2.6
    assert rows['processor time per simulated second']['between'] == '1.00 to 2.00'
    assert json.loads(json.dumps(found.to_dict()))['ratios']['memory_mb']['highest'] == 2.0
