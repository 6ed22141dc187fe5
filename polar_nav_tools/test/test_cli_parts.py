"""What stands behind the commands: settings of a replay, names, counts, tables, the suite."""

import io
import sys
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from polar_nav_core.errors import ConfigError
from polar_nav_tools.analysis.counts import topic_counts
from polar_nav_tools.development import suite as testing
from polar_nav_tools.live.run import new_bag_path
from polar_nav_tools.replay.output import parse_changes
from polar_nav_tools.scoring import Column, Table
from polar_nav_tools.terminal import progress
from polar_nav_tools.terminal.progress import progress_display
from polar_nav_tools.terminal.tables import print_table, size_text

# -- --set name=value


@pytest.mark.parametrize(
    ('text', 'name', 'value'),
    [
        ('max_delay_s=10', 'max_delay_s', 10.0),
        ('max_delay_s=1e1', 'max_delay_s', 10.0),
        ('leader_id=3', 'leader_id', 3),
        ('model_aiding=false', 'model_aiding', False),
        ('configuration=default', 'configuration', 'default'),
        ('heading_reference=true', 'heading_reference', 'true'),
        ('dvl_lever_b=[1, 0, -0.5]', 'dvl_lever_b', [1.0, 0.0, -0.5]),
    ],
)
def test_a_setting_gets_the_type_of_its_parameter(text, name, value):
    changes = parse_changes([text])
    assert changes == {name: value}
    assert type(changes[name]) is type(value)


@pytest.mark.parametrize('text', ['max_delay_s', '=3', 'colour=blue', 'dvl_lever_b=[1,'])
def test_a_setting_that_cannot_be(text):
    with pytest.raises(ConfigError):
        parse_changes([text])


# -- names of bags


def test_bag_names_tell_date_mission_seed_and_never_collide(tmp_path):
    now = datetime(2026, 3, 1, 12, 30, 5)
    first = new_bag_path(tmp_path, 'demo', 7, now)
    assert first.name == '20260301-123005_demo_7'
    first.mkdir()
    second = new_bag_path(tmp_path, 'demo', 7, now)
    assert second.name == '20260301-123005_demo_7_2'
    Path(f'{second}.run').mkdir()  # a run that is under way and has no bag yet
    assert new_bag_path(tmp_path, 'demo', 7, now).name == '20260301-123005_demo_7_3'


# -- counts


class _Topic:
    def __init__(self, count):
        self.count = count


class _Bag:
    def __init__(self):
        self.topics = {'/a': _Topic(10), '/b': _Topic(5), '/diagnostics': _Topic(99)}


def test_counts_join_publishers_and_take_the_worst_subscriber():
    counted = {
        '/p': {'published': {'/a': 6, '/b': 5}, 'taken': {}},
        '/q': {'published': {'/a': 4}, 'taken': {'/b': 5}},
        '/r': {'published': {}, 'taken': {'/a': 10, '/b': 4}},
        '/recorder_node': {'published': {}, 'taken': {'/a': 10, '/b': 5}},
    }
    a, b = topic_counts(_Bag(), counted)
    assert (a.topic, a.published, a.recorded, a.received, a.equal) == ('/a', 10, 10, 10, True)
    assert (b.topic, b.published, b.recorded, b.received, b.equal) == ('/b', 5, 5, 4, False)


def test_a_topic_that_was_not_recorded_is_not_equal_to_one_that_was_published():
    (row,) = topic_counts(_Bag(), {'/p': {'published': {'/c': 3}, 'taken': {}}})
    assert row.recorded is None
    assert row.received is None


# -- terminal


def printed(table, width, capsys):
    print_table(Console(width=width, force_terminal=False), table)
    return capsys.readouterr().out


def test_a_table_that_is_too_wide_is_turned_round(capsys):
    columns = tuple(Column(f'c{i}', f'column {i}') for i in range(12))
    table = Table('T', columns, ({f'c{i}': f'value{i}' for i in range(12)},))
    wide, narrow = printed(table, 300, capsys), printed(table, 60, capsys)
    assert max(map(len, narrow.splitlines())) <= 60
    for text in (wide, narrow):
        assert all(f'value{i}' in text for i in range(12))
    assert len(narrow.splitlines()) > len(wide.splitlines())


@pytest.mark.parametrize(
    ('size', 'text'), [(0, '0 B'), (999, '999 B'), (1_520_000, '1.52 MB'), (7e9, '7 GB')]
)
def test_sizes(size, text):
    assert size_text(size) == text


@pytest.mark.parametrize(
    ('takes_s', 'unit', 'lines'),
    [
        (1000.0, '%', []),
        (9.0, 'runs', []),
        (9.0, 's', [0]),
        (30.0, 'runs', [3, 7]),
        (1000.0, 'runs', [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]),
    ],
)
def test_progress_without_a_terminal_does_not_flood(capsys, monkeypatch, takes_s, unit, lines):
    now = iter(np.linspace(0.0, takes_s, 102))
    monkeypatch.setattr(progress.time, 'monotonic', lambda: next(now))
    with progress_display('work', total=10.0, unit=unit) as update:
        for i in range(0, 101):
            update(i / 10.0, 10.0)
    found = capsys.readouterr().err.splitlines()
    assert found == [f'polar: work: {k} of 10 {unit}' for k in lines]


@pytest.mark.parametrize(('terminal', 'large'), [(True, True), (True, False), (False, True)])
def test_the_opening_of_a_large_bag_is_shown_on_a_terminal(tmp_path, monkeypatch, terminal, large):
    monkeypatch.setenv('TERM', 'xterm')
    screen = io.StringIO()
    monkeypatch.setattr(screen, 'isatty', lambda: terminal, raising=False)
    monkeypatch.setattr(sys, 'stderr', screen)
    monkeypatch.setattr(progress, '_LARGE_BYTES', 10)
    (tmp_path / 'b_0.mcap').write_bytes(bytes(10 if large else 9))
    with progress.opening_display(tmp_path) as update:
        assert (update is None) == (not (terminal and large))
        if update is not None:
            update(0.25)
    assert ('opening' in screen.getvalue()) == (terminal and large)
    with progress.opening_display(tmp_path / 'nothing') as update:
        assert update is None


# -- polar test


def test_the_sources_are_found_from_below_and_from_outside(tmp_path):
    root = testing.source_root(Path(__file__).parent)
    assert (root / 'polar_nav_tools').is_dir()
    assert testing.source_root(tmp_path) == root  # where this module was imported from


def fake_suite(monkeypatch, *statuses):
    """Let each step of the suite end with a status; what was run."""
    ran = []

    class Done:
        stdout = ''

        def __init__(self, returncode):
            self.returncode = returncode

    def run(command, **_kwargs):
        ran.append(list(command))
        return Done(statuses[len(ran) - 1] if len(ran) <= len(statuses) else 0)

    monkeypatch.setattr(testing.subprocess, 'run', run)
    return ran


def test_the_suite_runs_everything_and_fails_when_one_step_did(monkeypatch, capsys, tmp_path):
    ran = fake_suite(monkeypatch, 0, 1)
    assert testing.run_suite(tmp_path, long=False, fast=False, arguments=[]) == 1
    assert len(ran) == 13
    *_, whole = (c for c in ran if 'live and not paced and not long' in c)
    assert whole[-1] == 'tests'
    # What comes before the three steps of graphs needs no graph.
    assert ran.index(whole) >= 10
    assert capsys.readouterr().err.startswith('failed: ')


def test_the_fast_ring_leaves_out_what_takes_long(monkeypatch, tmp_path):
    ran = fake_suite(monkeypatch)
    assert testing.run_suite(tmp_path, long=False, fast=True, arguments=[]) == 0
    tests = [command for command in ran if 'pytest' in command]
    assert len(tests) == 2  # one for each core
    for command in tests:
        assert command[command.index('-m', 2) + 1] == 'not slow and not live and not long'


def test_the_long_suite_leaves_out_nothing(monkeypatch, tmp_path):
    ran = fake_suite(monkeypatch)
    testing.run_suite(tmp_path, long=True, fast=False, arguments=[])
    marks = {c[c.index('-m', 2) + 1] for c in ran if 'pytest' in c and '-m' in c[3:]}
    fast = 'not slow and not live and not long'  # of the core without compiled kernels
    assert marks == {'live and paced', 'live and not paced', 'not live', fast}


def test_arguments_go_to_pytest_alone(monkeypatch, tmp_path):
    ran = fake_suite(monkeypatch)
    testing.run_suite(tmp_path, long=False, fast=False, arguments=['-k', 'supervisor'])
    assert len(ran) == 1
    assert ran[0][-2:] == ['-k', 'supervisor']
