"""The delay budget against hand calculation, and the parameters that it gives."""

import json
import sys
from dataclasses import replace

import pytest
import yaml

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.link.packet import SIZE
from polar_nav_leader.params import LeaderParams
from polar_nav_sim.params import AcousticLinkParams, UsblParams
from polar_nav_tools.cli import main
from polar_nav_tools.why.delay_budget import LinkBudget, delay_budget

# 3000 m at 1500 m/s: 2 s; 125 bytes at 1000 bit/s: 1 s.
ROUND = LinkBudget(
    range_m=3000.0,
    sound_speed=1500.0,
    bit_rate=1000.0,
    packet_bytes=125,
    turn_around_s=0.5,
    processing_s=0.25,
    detection_s=0.125,
    random_s=0.0,
    retries=0,
    followers=1,
    fix_period_s=10.0,
    margin=0.0,
    jitter_s=0.05,
)


def parts(budget):
    return {p.name: p.seconds for p in delay_budget(budget).parts}


def test_a_way_by_hand():
    result = delay_budget(ROUND)
    # There and back, processing, packet, detection; the turn-around lies before the validity.
    assert result.longest_s == pytest.approx(2.0 + 0.25 + 1.0 + 2.0 + 0.125, abs=1e-12)
    assert result.cycle_s == pytest.approx(2.0 + 0.5 + result.longest_s, abs=1e-12)
    assert result.pending == 1
    # Rounded up to tenths: 5.375 -> 5.4; history: 5.4 + 0.05 + two filter steps -> 5.7.
    assert result.parameters == pytest.approx(
        {'max_delay_s': 5.4, 'history_s': 5.7, 'reorder_window_s': 0.05}
    )
    assert result.problems == ()


def test_a_retry_costs_a_whole_time_out():
    twice = delay_budget(replace(ROUND, retries=2))
    # Packet 1, detection 0.125, there and back 4, turn-around 0.5.
    assert twice.longest_s - delay_budget(ROUND).longest_s == pytest.approx(2 * 5.625, abs=1e-12)


def test_other_followers_and_random_delay_are_waited_for():
    found = parts(replace(ROUND, followers=3, random_s=1.5))
    assert found['waiting for the channel'] == pytest.approx(2.0)
    assert found['random'] == pytest.approx(1.5)


def test_fixes_under_way_at_once():
    assert delay_budget(replace(ROUND, fix_period_s=1.0)).pending == 6
    assert delay_budget(replace(ROUND, fix_period_s=1.0, followers=2)).pending == 4
    # Ping, turn-around, reply, packet and its way: 2 + 0.5 + 2 + 1 + 2 of 10 s.
    assert delay_budget(ROUND).channel_share == pytest.approx(0.75)


@pytest.mark.parametrize('margin', [0.0, 0.1, 0.5])
@pytest.mark.parametrize('range_m', [1.0, 1234.5, 20000.0])
def test_the_parameters_hold_the_longest_delay_and_the_follower_takes_them(range_m, margin):
    result = delay_budget(replace(ROUND, range_m=range_m, margin=margin))
    assert result.parameters['max_delay_s'] >= result.longest_s * (1.0 + margin) - 1e-9
    read = yaml.safe_load(result.yaml())['/**']['ros__parameters']
    assert all(isinstance(v, float) for v in read.values())  # rclpy refuses 5 for a double
    params = EngineParams(**read)
    assert params.history_s > params.max_delay_s + params.filter_period_s


def test_what_no_follower_takes_is_said():
    (problem,) = delay_budget(replace(ROUND, retries=30)).problems
    assert 'max_delay_s' in problem
    assert '120.0' in problem


def test_defaults_are_those_of_the_nodes():
    b = LinkBudget()
    assert b.packet_bytes == SIZE
    assert b.bit_rate == LeaderParams().bit_rate
    assert b.processing_s == LeaderParams().processing_delay_s
    assert b.detection_s == AcousticLinkParams().detection_delay_s
    assert b.range_m == AcousticLinkParams().max_range_m
    assert b.turn_around_s == UsblParams().turn_around_s
    assert b.jitter_s == EngineParams().reorder_window_s


def test_values_out_of_range_are_refused():
    with pytest.raises(ConfigError, match='range_m'):
        LinkBudget(range_m=0.0)


# -- the command


@pytest.fixture
def polar(monkeypatch, capsys):
    monkeypatch.setenv('COLUMNS', '160')

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', 'delay-budget', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


def test_the_options_reach_the_calculation(polar):
    status, out, err = polar(
        '--range', 3000, '--sound-speed', 1500, '--bit-rate', 1000, '--packet-bytes', 125,
        '--turn-around', 0.5, '--processing', 0.25, '--detection', 0.125, '--retries', 2,
        '--followers', 3, '--fix-period', 10, '--margin', 0.25, '--jitter', 0.1, '--random', 1,
        '--json',
    )  # fmt: skip
    assert (status, err) == (0, '')
    got = json.loads(out)
    expected = delay_budget(
        replace(ROUND, retries=2, followers=3, margin=0.25, jitter_s=0.1, random_s=1.0)
    )
    assert got == {'ok': True, **json.loads(json.dumps(expected.to_dict()))}


def test_the_table_the_yaml_and_the_help(polar):
    status, out, err = polar('--range', 1500)
    assert (status, err) == (0, '')
    for words in ('reply to the array', 'packet to the follower', 'longest delay', 'max_delay_s:'):
        assert words in out
    status, out, _ = polar('--range', 1500, '--yaml')
    assert status == 0
    assert set(yaml.safe_load(out)['/**']['ros__parameters']) == {
        'max_delay_s', 'history_s', 'reorder_window_s',
    }  # fmt: skip
    status, out, _ = polar('--help')
    assert status == 0
    assert 'Example: ./polar delay-budget' in out
    for words in ('[bit/s]', '--retries', '20000'):
        assert words in out


def test_an_impossible_budget_ends_with_status_1_and_gives_no_parameters(polar):
    status, out, err = polar('--retries', 9, '--yaml')
    assert (status, out) == (1, '')
    assert err.startswith('polar: the follower cannot be set so: parameter max_delay_s')
    assert polar('--retries', 9)[1].count('max_delay_s:') == 0


@pytest.mark.parametrize(
    'bad', [['--range', '0'], ['--retries', 'x'], ['--yaml', '--json'], ['-x']]
)
def test_usage_errors_have_status_2(polar, bad):
    status, out, err = polar(*bad)
    assert (status, out) == (2, '')
    assert 'Traceback' not in err
