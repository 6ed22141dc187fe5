"""Several bags and configurations side by side: phases, error by age, drift, Markdown and CSV."""

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_tools.analysis.score_files import (
    label_bags,
    side_by_side,
    write_csv,
    write_markdown,
)
from polar_nav_tools.cli import main
from polar_nav_tools.report.example import example_input, example_truth
from polar_nav_tools.scoring import compare, mission_phases
from polar_nav_tools.scoring.by_age import EDGES_S
from polar_nav_tools.scoring.phases import SHORTEST_S
from polar_nav_tools.scoring.timeliness import age_of_information
from polar_nav_tools.scoring.verdicts import VerdictSeries

RUNS = example_input(minutes=2.0).runs
SCORES = compare(RUNS)
REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'


def sailed(*parts):
    """Truth that turns at given rates [deg/s] for given times [s]; only the velocity counts."""
    minutes = sum(seconds for _, seconds in parts) / 60.0
    truth = example_truth('v', 80.0, 0.0, minutes)
    t = (truth.stamp_ns - truth.stamp_ns[0]) * 1e-9
    rate, begin = np.zeros_like(t), 0.0
    for turn, seconds in parts:
        rate[(t >= begin) & (t < begin + seconds)] = np.deg2rad(turn)
        begin += seconds
    course = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(t))])
    truth.v_G[:] = 3.0 * np.stack([np.cos(course), np.sin(course), 0.0 * t], axis=1)
    return truth


def test_phases_are_legs_and_turns():
    truth = sailed((0.0, 100.0), (3.0, 60.0), (0.0, 120.0), (-3.0, 30.0), (0.0, 50.0))
    phases = mission_phases(truth)
    assert [p.name for p in phases] == ['leg 1', 'turn 1', 'leg 2', 'turn 2', 'leg 3']
    edges = [(p.start_ns - truth.stamp_ns[0]) * 1e-9 for p in phases]
    np.testing.assert_allclose(edges, [0.0, 100.0, 160.0, 280.0, 310.0], atol=2.0)
    # Every sample is in exactly one of them.
    inside = sum(p.mask(truth.stamp_ns).astype(int) for p in phases)
    assert (inside == 1).all()


def test_short_wiggles_are_no_phases():
    truth = sailed((0.0, 50.0), (5.0, SHORTEST_S - 4.0), (0.0, 50.0), (3.0, 60.0))
    assert [p.name for p in mission_phases(truth)] == ['leg 1', 'turn 1']
    assert mission_phases(sailed((0.0, 100.0))) == ()


def test_one_damaged_stamp_does_not_make_phases_of_years():
    """Found by mutating bags: a minute of truth whose last stamp is days away."""
    truth = sailed((0.0, 100.0), (3.0, 60.0))
    truth.stamp_ns[-1] += 200_000 * 1_000_000_000
    assert mission_phases(truth) == ()
    truth.stamp_ns[-1] -= 150_000 * 1_000_000_000  # half a day: a gap, as others have
    assert [p.name for p in mission_phases(truth)][:2] == ['leg 1', 'turn 1']


def test_phases_are_scored():
    truth, estimate, receipts = next(iter(RUNS.values()))
    middle = int(truth.stamp_ns[len(truth) // 3])
    from polar_nav_tools.scoring import Window

    phases = (
        Window('leg 1', int(truth.stamp_ns[0]), middle - 1),
        Window('turn 1', middle, int(truth.stamp_ns[-1])),
    )
    found = compare({'x': (truth, estimate, receipts)}, phases=phases)
    (table,) = [t for t in found.tables() if t.title == 'Phases of the mission']
    assert [r['phase'] for r in table.rows] == ['leg 1', 'turn 1']
    whole = found.scores['x'].whole.components['horizontal'].error
    counts = [found.scores['x'].windows[p.name].components['horizontal'].error for p in phases]
    squares = sum(c.count * c.rms**2 for c in counts)
    assert np.sqrt(squares / whole.count) == pytest.approx(whole.rms, rel=1e-12)


@pytest.mark.parametrize('name', RUNS)
def test_errors_by_age_are_all_errors_with_an_age(name):
    one = SCORES.scores[name]
    age = age_of_information(one.errors.stamp_ns, VerdictSeries.of(RUNS[name][2]))
    assert sum(c.horizontal.count for c in one.by_age) == np.isfinite(age).sum() > 0
    assert {c.from_s for c in one.by_age} <= set(EDGES_S)
    youngest = one.by_age[0]
    inside = (age >= youngest.from_s) & (age < youngest.to_s)
    rms = np.sqrt(np.mean(one.errors.horizontal[inside] ** 2))
    assert youngest.horizontal.rms == pytest.approx(rms, rel=1e-12)


def test_drift_table_has_percent_of_distance():
    (table,) = [t for t in SCORES.tables() if t.title == 'Drift and availability']
    for row, one in zip(table.rows, SCORES.scores.values(), strict=True):
        assert row['final_percent'] == 100.0 * row['final_error'] / row['distance']
        assert row['distance'] == pytest.approx(3.0 * 120.0, rel=1e-3)
        assert row['absolute_max'] >= row['absolute_p95'] >= one.absolute.median


def test_bags_are_called_by_their_folders():
    labels = label_bags([Path('a/run'), Path('b/other')])
    assert labels == {'run': Path('a/run'), 'other': Path('b/other')}
    assert list(label_bags([Path('a/run'), Path('b/run')])) == ['a/run', 'b/run']
    with pytest.raises(ConfigError, match='named twice'):
        label_bags([Path('a/run'), Path('a/run')])


def test_several_bags_have_the_bag_in_the_name():
    assert side_by_side({'x': SCORES}) is SCORES
    joined = side_by_side({'x': SCORES, 'y': SCORES})
    assert list(joined.scores) == [f'{bag}: {name}' for bag in 'xy' for name in RUNS]
    assert len(joined.table().rows) == 2 * len(RUNS)


def test_files_hold_every_number(tmp_path):
    tables = SCORES.tables()
    write_csv(tmp_path / 's.csv', tables)
    with (tmp_path / 's.csv').open(newline='') as stream:
        rows = list(csv.DictReader(stream))
    assert {r['table'] for r in rows} == {t.title for t in tables}
    name = next(iter(RUNS))
    (value,) = [
        r['value']
        for r in rows
        if (r['table'], r['row'], r['figure']) == (tables[0].title, name, 'r_x')
    ]
    assert float(value) == SCORES.scores[name].whole.rms('r_x')
    keys = [(r['table'], r['row'], r['figure']) for r in rows]
    assert len(set(keys)) == len(keys) - _repeated_ages(tables)
    write_markdown(tmp_path / 's.md', tables)
    text = (tmp_path / 's.md').read_text()
    assert text.count('\n**') + text.startswith('**') == len(tables)
    assert f'| {name}' in text


def _repeated_ages(tables):
    """Rows of the age table differ by numbers only."""
    (ages,) = [t for t in tables if t.title.endswith('age of the last fix')]
    again = len(ages.rows) - len({r['configuration'] for r in ages.rows})
    return again * (len(ages.columns) - 1)


def test_the_command_takes_bags_and_configurations_in_a_row(tmp_path, monkeypatch, capsys):
    def polar(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', 'score', *map(str, arguments)])
        status = main()
        said = capsys.readouterr()
        return status, said.out, said.err

    pytest.importorskip('rclpy')
    other = tmp_path / 'other'
    other.symlink_to(REFERENCE)
    names = ['conventional_akf', 'modified_akf', 'default']
    status, out, err = polar(
        REFERENCE, tmp_path / 'other', '--configs', *names, '--json', '--csv', tmp_path / 's.csv'
    )
    # A link to the same folder is the same bag, once by each path.
    said = json.loads(out)
    assert (status, said['ok']) == (0, True), err
    assert all(list(one['runs']) == names for one in said['bags'].values())
    assert len(said['bags']) == 2
    assert (tmp_path / 's.csv').is_file()
    status, out, _ = polar(REFERENCE, '--configs', 'modified_akf,default', '--json')
    assert (status, list(json.loads(out)['runs'])) == (0, ['modified_akf', 'default'])
    status, _, err = polar(REFERENCE, '--configs', 'best')
    assert status == 2
    assert 'best' in err
