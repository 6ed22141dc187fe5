"""`polar test` itself, with steps that say what they are told: order, status, what is shown."""

import sys
import tomllib
from pathlib import Path

import pytest

from polar_nav_tools.development import suite as testing
from polar_nav_tools.development.suite import (
    Step,
    all_rings,
    fast_ring,
    run_suite,
    source_root,
)


def step(name, status=0):
    code = f'import sys; print("said by {name}"); sys.exit({status})'
    return Step(name, (sys.executable, '-c', code))


@pytest.fixture
def suite(tmp_path, monkeypatch, capfd):
    def run(first, last, **options):
        monkeypatch.setattr(testing, 'tests', lambda *_, **__: last)
        monkeypatch.setattr(testing, 'fast_ring', lambda _: [last, *first])
        rings = ([step('core'), *first], [last, step('in real time')])
        monkeypatch.setattr(testing, 'all_rings', lambda *_, **__: rings)
        asked = {'long': False, 'fast': False, 'arguments': [], **options}
        status = run_suite(tmp_path, **asked)
        return status, *capfd.readouterr()

    return run


@pytest.mark.parametrize('fast', [True, False])
@pytest.mark.parametrize('broken', ['style', 'types', 'tests', None])
def test_whatever_fails_is_told_and_all_run(suite, fast, broken):
    first = [step(name, 3 * (name == broken)) for name in ('style', 'types')]
    status, out, err = suite(first, step('tests', 3 * (broken == 'tests')), fast=fast)
    assert status == (broken is not None)
    assert ('failed' in err) == (broken is not None)
    if broken is not None:
        assert err.strip() == f'failed: {broken}'
        assert broken == 'tests' or f'{broken}: failed with status 3' in out
    for name in ('style', 'types', 'tests'):
        assert f'== {name}' in out
    for name in ('style', 'types', 'tests'):
        assert f'said by {name}' in out


def test_whole_graphs_come_last_and_pytest_has_the_last_word(suite):
    _, out, _ = suite([step('style')], step('tests'))
    assert out.index('style: ok') < out.index('== tests') < out.index('== in real time: ok')
    assert out.strip().splitlines()[-1] == 'said by in real time'


def test_the_fast_ring_does_not_wait_for_the_checks(suite, tmp_path):
    """Each waits for the other's file: one after the other, the first would wait in vain."""
    code = """
import pathlib, sys, time
mine, other = map(pathlib.Path, sys.argv[1:])
mine.touch()
end = time.monotonic() + 30
while not other.exists():
    time.sleep(0.02)
    if time.monotonic() > end:
        sys.exit(1)
"""
    names = [str(tmp_path / 'a'), str(tmp_path / 'b')]
    check = Step('check', (sys.executable, '-c', code, *names))
    test = Step('test', (sys.executable, '-c', code, *reversed(names)))
    assert suite([check], test, fast=True)[0] == 0


def test_of_what_went_well_on_the_other_core_only_the_last_line_is_shown(suite):
    code = 'print("first line"); print("12 passed")'
    long = Step('tools', (sys.executable, '-c', code))
    _, out, _ = suite([long], step('tests'), fast=True)
    assert '12 passed' in out
    assert 'first line' not in out


def test_a_core_that_is_free_takes_the_next_step(suite, tmp_path):
    """The last step comes to its end although the step before it waits for it."""
    here = str(tmp_path / 'here')
    waits = """
import pathlib, sys, time
end = time.monotonic() + 30
while not pathlib.Path(sys.argv[1]).exists():
    time.sleep(0.02)
    if time.monotonic() > end:
        sys.exit(1)
"""
    makes = 'import pathlib, sys; pathlib.Path(sys.argv[1]).touch()'
    waiting = Step('waiting', (sys.executable, '-c', waits, here))
    making = Step('making', (sys.executable, '-c', makes, here))
    for first in ([waiting, step('short'), making], [step('short'), waiting, making]):
        status, out, _ = suite(first, step('tests'), fast=True)
        assert status == 0
        assert out.count('making: ok') == 1
        Path(here).unlink()


def test_the_steps_are_all_tests_there_are():
    root = source_root(Path(__file__))
    config = tomllib.loads((root / 'pyproject.toml').read_text())
    folders = sorted(config['tool']['pytest']['ini_options']['testpaths'])
    lower, tools, *_ = fast_ring('python')
    assert folders_of([lower, tools], folders) == folders
    for long in (True, False):
        steps, graphs = all_rings('python', root, long=long)
        lower, tools, experiments, files, builds, *_ = steps
        live, paced, missions = graphs
        assert folders_of([lower, tools, live], folders) == folders
        # One folder in two steps: each of its files is in one of them.
        named = [c for c in experiments.command if c.endswith('.py')]
        (pattern,) = (c for c in tools.command if c.startswith('--ignore-glob=*/'))
        ignored = (root / tools.command[-1]).glob(pattern.partition('*/')[2])
        assert sorted(map(str, ignored)) == sorted(str(root / name) for name in named)
        # Or in three by marks, each of which is the rest of another.
        assert {s.command[-1] for s in (files, live, paced)} == {'tests'}
        rest = '' if long else ' and not long'
        assert after('-m', files) == f'not live{rest}'
        assert after('-m', live) == f'live and not paced{rest}'
        assert after('-m', paced) == f'live and paced{rest}'
        # Or without files that are steps of their own.
        for one in (files, live, paced):
            assert f'--ignore={builds.command[-1]}' in one.command
        for one in (live, paced):
            assert f'--ignore={missions.command[-1]}' in one.command
        for one in (lower, tools, experiments, builds, missions):
            assert ('not long' in one.command) != long


def test_missions_have_no_test_that_is_left_to_the_step_of_files():
    file = source_root(Path(__file__)) / 'tests' / 'test_live_missions.py'
    assert '\npytestmark = [pytest.mark.live, ' in file.read_text()


def test_steps_of_tools_beside_one_another_have_domains_of_their_own(monkeypatch):
    steps, graphs = all_rings('python', source_root(Path(__file__)), long=False)
    domains = [s.env['ROS_DOMAIN_ID'] for s in steps if 'ROS_DOMAIN_ID' in s.env]
    assert len(set(domains)) == len(domains) == 2
    monkeypatch.setattr(testing, 'busy_udp_ports', lambda: [7400 + 250 * int(domains[0])])
    monkeypatch.setattr('os.getpid', lambda: int(domains[0]) - 1)
    found = [one['ROS_DOMAIN_ID'] for one in testing._own_domains(3)]
    assert len({domains[0], *found}) == 4
    # In steps of graphs each graph chooses its own, also where the user has named one.
    assert [s.env for s in graphs] == [{'ROS_DOMAIN_ID': ''}] * 3


def after(option, step):
    """Value of an option of a step's command."""
    return step.command[len(step.command) - 1 - step.command[::-1].index(option) + 1]


def folders_of(steps, folders):
    """Folders in which steps look for tests, in order of name."""
    return sorted(c for s in steps for c in s.command if c in folders)


def test_with_arguments_only_pytest_runs(suite):
    status, out, _ = suite([step('style', 1)], step('tests'), arguments=['-k', 'x'])
    assert status == 0
    assert 'style' not in out
