"""`polar calibrate`: a mapping with errors is put right, comments stay; JSON and refusals."""

import json
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import yaml
from foreign_worlds import (
    DVL_LEVER_B,
    Recorder,
    aiding_columns,
    imu_column,
    mapping,
    stamps_of,
    truth_of,
    write_columns,
)

from polar_nav_core.attitude import log
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters import mapping_file, rotations
from polar_nav_tools.calibration import write
from polar_nav_tools.calibration.bag import Calibration
from polar_nav_tools.calibration.constants import CONSTANTS, NAMES
from polar_nav_tools.calibration.verdicts import Line, Verdict
from polar_nav_tools.cli import main

BAGS = Path(__file__).parents[2] / 'bags'
DURATION_S = 400.0
LEVER_B = (1.2, -0.2, 0.3)
COMMENT = '# bolted on in June, ask Ada'
WRONG = {'dvl_yaw': 2.0, 'dvl_lever_x': 0.5, 'delay': 2.0}
"""What the mapping of the test states too much of."""


def polar(*words):
    """Exit status of the command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, 'argv', ['polar', *map(str, words)])
        return main()


@pytest.fixture(scope='module')
def vehicle(tmp_path_factory):
    """A bag of ROS's own types, IMU in the bow, and a mapping with three errors."""
    folder = tmp_path_factory.mktemp('calibrate')
    truth, make = truth_of(DURATION_S), Recorder()
    stamps = stamps_of(truth, 0.0, DURATION_S, 0.01)
    columns = [imu_column(make, truth, stamps, lever_b=LEVER_B)]
    columns += aiding_columns(make, truth, 0.0, DURATION_S)
    bag = write_columns(folder / 'bag', make, columns)
    what = mapping({'lever_b': list(LEVER_B)})
    what['dvl']['rotation'] = {'rpy_deg': [180.0, 0.0, WRONG['dvl_yaw']]}
    what['dvl']['lever_b'] = [DVL_LEVER_B[0] + WRONG['dvl_lever_x'], *DVL_LEVER_B[1:]]
    what['fixes'][0]['time_offset_s'] = WRONG['delay']
    text = yaml.safe_dump(what, sort_keys=False)
    path = folder / 'mapping.yaml'
    path.write_text(text.replace('dvl:\n', f'dvl:\n  {COMMENT}\n'))
    return bag, path


@pytest.mark.slow
def test_a_mapping_is_put_right(vehicle, capsys):
    bag, path = vehicle
    assert polar('calibrate', bag, '--map', path, '--write', '--json') == 0
    said = json.loads(capsys.readouterr().out)
    for name, too_much in WRONG.items():
        (line,) = [c for c in said['constants'] if c['name'] == name]
        assert line['verdict'] == 'ESTIMATED', name
        assert (
            abs(line['add'] + (too_much if name != 'delay' else -too_much)) < 4.0 * line['sigma']
        )
        assert abs(line['add']) > 4.0 * line['sigma']
        assert name in said['written']['constants']
    new = path.with_name('mapping_calibrated.yaml')
    text = new.read_text()
    assert said['written']['path'] == str(new)
    assert COMMENT in text
    assert '# polar calibrate bag of 2026-03-01: dvl_yaw' in text
    right = mapping_file.load(new)
    turned = np.degrees(log(right.dvl.C_s_b @ rotations.named('frd').T))
    np.testing.assert_allclose(turned, 0.0, atol=0.5)
    assert right.params['dvl_lever_b'][0] == pytest.approx(DVL_LEVER_B[0], abs=0.1)
    assert abs(right.fixes[0].position.stream.offset_ns) < 1e9
    left = {c['name']: c['sigma'] for c in said['constants']}
    assert right.params['fix_clock_sigma'] == pytest.approx(left['delay'], rel=1e-3)
    yaw_or_pitch = max(left['dvl_yaw'], left['dvl_pitch'])
    assert right.params['dvl_misalignment_sigma_deg'] == pytest.approx(yaw_or_pitch, rel=1e-3)
    # What was put right is not off any more.
    assert polar('calibrate', bag, '--map', new, '--json') == 0
    for line in json.loads(capsys.readouterr().out)['constants']:
        if line['name'] in WRONG:
            assert abs(line['add']) < 0.5 * line['sigma']
    assert polar('calibrate', bag, '--map', path, '--write') == 2
    assert 'exists' in capsys.readouterr().err


@pytest.mark.slow
def test_constants_that_did_not_settle_are_written_nowhere(vehicle, capsys, monkeypatch):
    bag, path = vehicle
    new = path.with_name('unsettled.yaml')
    new.write_text(path.read_text())
    monkeypatch.setattr('polar_nav_tools.calibration.estimate.MOST_ROUNDS', 1)
    assert polar('calibrate', bag, '--map', new, '--write') == 1
    assert 'nothing is written' in capsys.readouterr().err
    assert not new.with_name('unsettled_calibrated.yaml').exists()


ONE_LINE_EACH = """\
version: 2
imu: {topic: /imu/data}
dvl: {topic: /dvl, rotation: frd, sound_speed: 1500.0}  # ours
fixes:
  - {topic: /usbl, delay_s: 5.0}   # of the ship
noise: {imu: stim300, dvl: workhorse_1200, fix_clock_sigma: 0.02}
"""


def test_values_and_what_is_left_of_them_go_where_they_belong(tmp_path):
    path = tmp_path / 'm.yaml'
    path.write_text(ONE_LINE_EACH)
    off = {'delay': 0.5, 'dvl_latency': 0.1, 'dvl_scale': 1.0, 'dvl_lever_x': 2.0}
    by_name = {c.name: c for c in CONSTANTS}
    lines = tuple(Line(by_name[n], v, 0.05, Verdict.ESTIMATED, '') for n, v in off.items())
    day = datetime(2026, 3, 1, tzinfo=UTC)
    what = mapping_file.load(path)
    found = Calibration(path, 'auv', FollowerParams(), day, None, lines)
    written = write.mapping_file(path, found, what, ())
    assert set(written.names) == set(off)
    assert not written.left
    new = mapping_file.parse(written.text, 'new')
    assert new.fixes[0].position.stream.offset_ns == -500_000_000
    assert new.fixes[0].delay_ns == 5_500_000_000
    assert new.dvl.stream.offset_ns == -100_000_000
    assert new.params['dvl_lever_b'] == [2.0, 0.0, 0.0]
    assert new.params['water_sound_speed'] == pytest.approx(1500.0 / 1.01)
    assert new.params['fix_clock_sigma'] == 0.05
    assert '# ours' in written.text
    assert '# of the ship' in written.text
    path.write_text(written.text)  # in which the water is stated already
    again = write.mapping_file(path, found, new, ())
    assert 'water_sound_speed: 1470.' in again.text


def test_a_straight_run_says_what_would_show_it(capsys, tmp_path):
    figure = tmp_path / 'innovations.svg'
    words = ['--only', 'delay', '--plot', figure]
    assert polar('calibrate', BAGS / 'reference_4', *words) == 0
    assert '<svg' in figure.read_text()
    out = capsys.readouterr().out
    assert 'NOT_EXCITED' in out
    assert 'lawnmower' in out


@pytest.mark.slow
def test_json_of_the_usual_constants(capsys):
    assert polar('calibrate', BAGS / 'reference_4', '--json', '--also', 'dvl_lever_z') == 0
    said = json.loads(capsys.readouterr().out)
    names = [c['name'] for c in said['constants']]
    assert said['ok']
    assert {'delay', 'dvl_yaw', 'dvl_scale', 'range_scale', 'dvl_lever_z'} <= set(names)
    assert set(names) <= set(NAMES)
    keys = {'name', 'add', 'sigma', 'unit', 'prior_sigma', 'verdict', 'why', 'about'}
    assert all(set(c) == keys for c in said['constants'])
    assert np.shape(said['correlation']) == (len(names), len(names))
    np.testing.assert_allclose(np.diag(said['correlation']), 1.0)
    assert said['mean_squared_innovation']['dvl']['after'] == pytest.approx(1.0, abs=0.3)


def test_without_a_mapping_parameters_are_printed(capsys):
    words = ['--only', 'dvl_lever_y', '--only', 'delay', '--write']
    assert polar('calibrate', BAGS / 'reference_4', *words) == 0
    said = capsys.readouterr()
    values = yaml.safe_load(said.out[said.out.index('parameters:') :])
    assert abs(values['parameters']['dvl_lever_b'][1]) < 0.05
    assert 'delay is not written' in said.err


@pytest.mark.parametrize(
    ('words', 'text'),
    [
        (['station'], 'mode sins'),
        (['reference_4', '--only', 'yaw'], 'no constant'),
        (['reference_4', '--only', 'heading_bias'], 'measured headings'),
        (['reference_4', '--accept', 'x'], '--map'),
        (['reference_4', '--assign', 'array_yaw'], '--write'),
        (['reference_4', '--plot', 'README.md'], 'exists'),
        (['reference_4', '--plot', 'figure.pdf'], '.png'),
        (['reference_4', '--write', '--only', 'delay', '--assign', 'delay'], 'no sum'),
    ],
)
def test_what_cannot_be_calibrated_is_named(words, text, capsys, monkeypatch):
    monkeypatch.chdir(BAGS)
    assert polar('calibrate', *words) == 2
    assert text in capsys.readouterr().err
