"""`polar smooth`: nearer to the truth, honest about it, into files that others read; refusals."""

import csv
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polar_nav_core.engine.health.conditions import Condition, Culprit, Health, Level, Present
from polar_nav_ros.stamps import to_ns
from polar_nav_tools.bags import open_bag
from polar_nav_tools.bags.arrays import load_estimates, load_receipts
from polar_nav_tools.cli import main
from polar_nav_tools.smoothing import bag as bag_module
from polar_nav_tools.smoothing.bag import How, smooth_bag, stated_sigma

BAGS = Path(__file__).parents[2] / 'bags'


def polar(*words):
    """Exit status of the command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, 'argv', ['polar', *map(str, words)])
        return main()


def smoothed(every_s):
    return smooth_bag(
        open_bag(BAGS / 'reference_4'),
        'follower',
        configuration='default',
        changes={},
        how=How(every_s),
        progress=lambda _: None,
    )


def test_it_is_nearer_to_the_truth_and_surer():
    run = smoothed(0.5)
    scores = run.comparison.scores
    filtered, smooth = (scores[name].whole.rms('horizontal') for name in ('filter', 'smoother'))
    assert smooth < 0.5 * filtered
    assert stated_sigma(run.smoothed) < 0.8 * stated_sigma(run.filtered)
    assert scores['smoother'].whole.nees_position.judgement != 'optimistic'


@pytest.fixture(scope='module')
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp('smooth')
    files = [folder / 'bag', folder / 'track.tum', folder / 'track.csv']
    words = ['smooth', BAGS / 'reference_4', '--out', files[0], '--tum', files[1]]
    assert polar(*words, '--csv', files[2], '--every', '0.5') == 0
    return files


def test_how_many_fixes_were_used_is_said(capsys):
    """Without a truth there is no table that would show that most were refused."""
    assert polar('smooth', BAGS / 'reference_4') == 0
    assert 'fixes used: filter 13 of 13, smoother 13 of 13\n' in capsys.readouterr().out
    assert polar('smooth', BAGS / 'reference_4', '--json') == 0
    fixes = json.loads(capsys.readouterr().out)['fixes']
    assert fixes == {name: {'used': 13, 'of': 13} for name in ('filter', 'smoother')}


def test_poses_at_the_stamps_of_a_topic(tmp_path):
    files = [tmp_path / 'at.csv', tmp_path / 'at.kml']
    words = ['smooth', BAGS / 'reference_4', '--at', '/follower/dvl/data', '--csv', files[0]]
    assert polar(*words, '--kml', files[1]) == 0
    pings = [to_ns(m.header.stamp) for _, m in open_bag(BAGS / 'reference_4').read(words[3])]
    with files[0].open() as stream:
        rows = {int(row['stamp_ns']): row for row in csv.DictReader(stream)}
    assert len(rows) > 0.9 * len(pings)
    assert set(rows) <= set(pings)
    close = smoothed(0.01).smoothed
    places = dict(zip(close.stamp_ns.tolist(), close.r_e, strict=True))
    off = [
        np.linalg.norm([float(row[f'{x}_m']) for x in 'xyz'] - places[stamp])
        for stamp, row in rows.items()
        if stamp in places
    ]
    assert len(off) > 100
    assert max(off) < 2e-3
    assert files[1].read_text().count('<when>') == len(rows)


@pytest.mark.parametrize('command', ['smooth', 'calibrate'])
def test_of_a_recording_that_was_cut_off_the_figures_are_given(tmp_path, capsys, command):
    whole = (BAGS / 'reference_4' / 'reference_4_0.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(whole[:1_500_000])
    assert polar(command, tmp_path / 'cut.mcap', '--json') == 1
    out, err = capsys.readouterr()
    assert json.loads(out)['ok'] is False
    assert 'the file ends within a record' in err


def test_a_topic_that_is_not_there_is_named(tmp_path, capsys):
    words = ['smooth', BAGS / 'reference_4', '--at', '/nothing', '--kml', tmp_path / 'x.kml']
    assert polar(*words) == 2
    assert 'no message on /nothing' in capsys.readouterr().err


def test_the_bag_holds_the_smoothed_track(written):
    run = smoothed(0.5)
    bag = open_bag(written[0])
    recorded = load_estimates(bag, 'follower')
    assert bag.run_info['smoothing_of'].endswith('reference_4')
    for name in ('stamp_ns', 'r_e', 'v_G', 'P_position_G'):
        np.testing.assert_array_equal(getattr(recorded, name), getattr(run.smoothed, name), name)


def test_files_for_others(written):
    poses = [line.split() for line in written[1].read_text().splitlines()]
    with written[2].open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(poses) == len(rows) == 60
    assert float(poses[7][1]) == float(rows[7]['x_m'])
    assert 0.0 < float(rows[7]['sigma_grid_east_m']) < 1.0


def test_json(capsys):
    assert polar('smooth', BAGS / 'reference_4', '--json') == 0
    said = json.loads(capsys.readouterr().out)
    assert said['ok']
    assert said['estimates'] == 30
    assert said['stated_horizontal_m']['smoother'] < said['stated_horizontal_m']['filter']
    assert set(said['score']) == {'filter', 'smoother'}


@pytest.mark.slow
def test_score_and_report_show_filter_and_smoother_side_by_side(tmp_path, capsys):
    words = [BAGS / 'reference_4', '-c', 'default', '--smooth']
    assert polar('score', *words, '--json') == 0
    runs = json.loads(capsys.readouterr().out)['runs']
    assert set(runs) >= {'default', 'smoother'}
    rms = {name: run['summary']['r_x'] for name, run in runs.items()}
    assert rms['smoother'] < 0.5 * rms['default']
    assert polar('report', *words, '--out', tmp_path / 'report.html') == 0
    page = (tmp_path / 'report.html').read_text()
    assert 'smoother' in page
    # The delay is that of the fixes as they came; a smoother has each when it is valid.
    delay = re.search(r'Mean delay of a fix</dt>\s*<dd class="value">([\d.]+)', page)
    assert 1.0 < float(delay[1]) < 5.0


@pytest.mark.slow
def test_revisions_are_reported_and_written(tmp_path, capsys):
    """A gate that is too narrow decides much, and otherwise with hindsight."""
    words = ['smooth', BAGS / 'reference_4', '-c', 'custom', '--set', 'gate_probability=0.7']
    assert polar(*words, '--out', tmp_path / 'bag', '--json') == 0
    found = json.loads(capsys.readouterr().out)['smoothing']
    assert found['passes'] == 3
    fixes = [r for r in found['revisions'] if r['topic'] == 'acomms/rx']
    assert fixes
    assert {(r['from'], r['to']) for r in found['revisions']} == {
        ('FUSED', 'GATED'),
        ('GATED', 'FUSED'),
    }
    bag = open_bag(tmp_path / 'bag')
    receipts = load_receipts(bag, 'follower')
    revised = {r.sequence: r for r in receipts if r.revision}
    assert set(revised) == {r['number'] for r in fixes}
    assert all('hindsight' in r.reason for r in revised.values())
    assert bag.run_info['smoothing']['revisions'] == found['revisions']
    assert polar(*words) == 0
    said = capsys.readouterr().out
    assert 'with hindsight GATED -> FUSED' in said
    assert polar(*words, '--passes', '1') == 0
    assert 'hindsight' not in capsys.readouterr().out.split('not settled')[0]


@pytest.mark.parametrize(
    ('words', 'text'),
    [
        (['station', '-c', 'published'], 'station_filter published'),
        (['reference_4', '-c', 'modified_akf'], 'stated noise'),
        (['reference_4', '--accept', 'x'], '--map'),
        (['reference_4', '--at', '/follower/dvl/data'], 'goes with --tum'),
        (['reference_4', '--csv', 'station/metadata.yaml'], 'exists'),
    ],
)
def test_what_cannot_be_smoothed_is_named(words, text, capsys, monkeypatch):
    monkeypatch.chdir(BAGS)
    assert polar('smooth', *words) == 2
    assert text in capsys.readouterr().err


@pytest.fixture(scope='module')
def of_station(tmp_path_factory):
    """Exit status and new bag of a recording of station mode."""
    out = tmp_path_factory.mktemp('station') / 'bag'
    return polar('smooth', BAGS / 'station', '--out', out), out


def test_a_recording_of_station_mode(of_station):
    status, out = of_station
    assert status == 0
    bag = open_bag(out)
    before = load_estimates(open_bag(BAGS / 'station'), 'auv')
    after = load_estimates(bag, 'auv')
    sigmas = [
        np.median(np.sqrt(np.trace(e.P_position_G[:, :2, :2], axis1=1, axis2=2)))
        for e in (before, after)
    ]
    assert sigmas[1] < 0.6 * sigmas[0]
    models = [m for _, m in bag.read('/auv/nav/model')]
    assert len(models) == len(after)
    assert all(m.drag_quadratic_sigma > 0.0 for m in models)


@pytest.mark.slow
def test_scores_of_both_stand_side_by_side_in_station_mode(capsys):
    assert polar('score', BAGS / 'station', '-c', 'default', '--smooth', '--json') == 0
    runs = json.loads(capsys.readouterr().out)['runs']
    assert runs['smoother']['summary']['r_x'] < 0.7 * runs['default']['summary']['r_x']


@pytest.mark.parametrize(
    ('level', 'status', 'well_later', 'said_of_it'),
    [
        (Level.WARN, 0, 0, 'WARN at the end'),
        (Level.WARN, 0, 199, 'WARN for 0.5 % of the time'),
        (Level.ERROR, 1, 0, 'ERROR at the end'),
    ],
)
def test_what_the_filter_was_warned_of_is_said(
    level, status, well_later, said_of_it, monkeypatch, capsys
):
    """What contradicts the filter's model contradicts that of the smoother, too."""
    condition = Condition('slow fault', level, Culprit.FIXES, 'fixes drift')
    well = Health(2, (), 1.0, 0)
    sure = Condition('dvl too sure', Level.WARN, Culprit.DVL, 'the DVL states less noise')
    present = tuple(Present(one, 1, 1) for one in (condition, sure))
    health = (Health(1, present, 1.0, 0), *[well] * well_later)
    real = bag_module.smooth_bag

    def warned(*args, **kwargs):
        return replace(real(*args, **kwargs), health=health)

    monkeypatch.setattr(bag_module, 'smooth_bag', warned)
    assert polar('smooth', BAGS / 'reference_4', '--passes', '1', '--json') == status
    said = capsys.readouterr()
    assert f'the filter was not well: {said_of_it}: fixes drift' in said.err
    found = json.loads(said.out)['filter_health']
    assert found['level_at_end'] == health[-1].level.name
    share = '100' if len(health) == 1 else '0.5'
    word = f'WARN for {share} % of the time: the DVL states less noise'
    assert found['conditions'][1] == word
    assert word in said.err
