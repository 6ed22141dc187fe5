"""Which runs decide the exit status: what ran live and `default`, or the one that was named."""

import json
import sys
from pathlib import Path

import pytest

from polar_nav_core.engine.health.conditions import Condition, Culprit, Health, Level, Present
from polar_nav_core.engine.health.span import Look, Span, span_of
from polar_nav_tools.analysis import analyse as analysis
from polar_nav_tools.analysis.judged import LIVE, judged_of, live_span
from polar_nav_tools.bags import open_bag
from polar_nav_tools.cli import main

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
BAD = Condition('fixes gated', Level.ERROR, Culprit.FIXES, '9 fixes gated')


@pytest.fixture
def polar(monkeypatch, capsys):
    monkeypatch.setenv('COLUMNS', '200')

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


def unwell(health):
    """The same judgements, each with an ERROR."""
    return tuple(
        Health(h.stamp_ns, (Present(BAD, h.stamp_ns, 1),), h.radius_95, h.resets) for h in health
    )


def test_the_default_decides_among_several_and_one_for_itself():
    assert judged_of(['conventional_akf', 'modified_akf', 'default']) == ('default',)
    assert judged_of(['conventional_akf']) == ('conventional_akf',)
    assert judged_of(['conventional_akf', 'modified_akf']) == ()
    assert judged_of([]) == ()


def test_levels_of_the_live_run_are_those_of_its_diagnostics():
    span = live_span(open_bag(REFERENCE), 'follower')
    assert span.looks > 0
    assert span.complaint == ''
    assert live_span(open_bag(REFERENCE), 'nobody') == Span()


@pytest.mark.parametrize(
    ('bad', 'arguments', 'expected'),
    [
        ('conventional_akf', (), 0),
        ('default', (), 1),
        (LIVE, (), 1),
        (LIVE, ('--recorded',), 1),
        (LIVE, ('-c', 'default'), 0),
        ('conventional_akf', ('-c', 'conventional_akf'), 1),
        ('modified_akf', ('-c', 'conventional_akf', '-c', 'modified_akf'), 0),
    ],
)
def test_errors_beside_the_judged_runs_are_only_said(polar, monkeypatch, bad, arguments, expected):
    real = analysis.load_replays

    def load_replays(*args, **kwargs):
        replays = real(*args, **kwargs)
        replayed = replays.replayed

        def changed(*a):
            runs = replayed(*a)
            for name, run in runs.items():
                assert run.health  # it was looked at
                if name == bad:
                    object.__setattr__(run, 'health', unwell(run.health))
            return runs

        replays.replayed = changed
        return replays

    monkeypatch.setattr(analysis, 'load_replays', load_replays)
    if bad == LIVE:
        look = Look(Level.ERROR, BAD.sentence)
        monkeypatch.setattr(analysis, 'live_span', lambda *_: span_of([look]))
    status, out, err = polar('score', REFERENCE, '--json', *arguments)
    assert status == expected
    said = json.loads(out)
    assert said['ok'] is (expected == 0)
    sentence = f'{bad}: ERROR at the end: 9 fixes gated'
    assert (sentence in said['complaints']) is (expected == 1)
    assert (sentence in said['remarks']) is (expected == 0)
    assert sentence in err


def test_a_replay_that_ends_in_error_is_not_well(polar):
    """The vehicle of the bag sails 3 m/s."""
    command = ('replay', REFERENCE, '-c', 'default', '--json')
    status, out, err = polar(*command, '--set', 'max_speed=1.0')
    assert status == 1
    said = json.loads(out)
    assert said['ok'] is False
    assert said['health']['level_at_end'] == 'ERROR'
    assert 'is faster than max_speed' in err
    assert polar(*command)[0] == 0
