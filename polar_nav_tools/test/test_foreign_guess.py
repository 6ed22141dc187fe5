"""What a guessed mapping makes of topics that are not named, signed or scaled as ours."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from foreign_worlds import (
    DEPTH,
    FIXES,
    IMU,
    ORIGIN,
    TRUTH,
    Column,
    Recorder,
    S,
    imu_column,
    stamped,
    stamps_of,
    truth_of,
)
from foreign_worlds import aiding_columns as aiding
from test_foreign_map import KNOWN, guessed, with_stamps

from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters.mapping import Frame, PositionMapping, Stream
from polar_nav_tools.bags.reader import Topic
from polar_nav_tools.foreign.candidates import outputs_of
from polar_nav_tools.foreign.read import read_positions
from polar_nav_tools.foreign.sources import open_source

POINT = 'geometry_msgs/msg/PointStamped'
DAY = 86_400 * 1_000_000_000
Columns = tuple[Recorder, list[Column]]


@pytest.fixture(scope='module')
def columns() -> Columns:
    """Forty seconds of everything: two fixes."""
    truth, make = truth_of(40.0), Recorder()
    imu = imu_column(make, truth, stamps_of(truth, 0.0, 40.0, 0.01))
    return make, [imu, *aiding(make, truth, 0.0, 40.0)]


def test_heights_are_told_by_their_sign(columns: Columns, tmp_path: Path) -> None:
    """Minus eight metres is no depth: taken as one, the vehicle would be in the air."""
    make, (imu, _, depth, *_) = columns
    z = -8.0 - np.linspace(0.0, 1.0, len(depth.log_ns))
    template = make.make(POINT, header=make.header('odom'), point=make.vector('Point'))
    values = stamped(depth.log_ns) | {'point.z': z}
    heights = Column('/depth', POINT, depth.log_ns, template, values)
    top = yaml.safe_load(guessed(tmp_path / 'up', make, [imu, heights]))
    assert top['depth']['positive'] == 'up'
    depths = replace(heights, values=heights.values | {'point.z': -z})
    text = guessed(tmp_path / 'down', make, [imu, depths])
    assert 'positive' not in yaml.safe_load(text)['depth']
    assert 'positions that are not used' not in text


@pytest.mark.parametrize(('unit', 'pascals'), [('hPa', 100.0), ('kPa', 1e3), ('bar', 1e5)])
def test_the_unit_of_a_pressure_that_is_no_pascal(
    columns: Columns, tmp_path: Path, unit: str, pascals: float
) -> None:
    """The type says Pa, drivers write what the sensor's library gives."""
    make, (imu, _, depth, *_) = columns
    surface = 101325.0 + 1e4 * np.linspace(0.1, 3.0, len(depth.log_ns))
    wrong = replace(depth, values=depth.values | {'fluid_pressure': surface / pascals})
    text = guessed(tmp_path, make, [imu, wrong])
    assert (
        yaml.safe_load(text)['depth'] | {'topic': DEPTH, 'unit': unit}
        == (yaml.safe_load(text)['depth'])
    )
    assert 'no absolute pressure in Pa' in text


def test_gauge_pressures_are_told_by_the_surface(columns: Columns, tmp_path: Path) -> None:
    """Zero at the surface: taken as absolute, the vehicle would be ten metres up in the air."""
    make, (imu, _, depth, *_) = columns
    gauge = 1e4 * np.linspace(0.1, 9.0, len(depth.log_ns))
    text = guessed(
        tmp_path, make, [imu, replace(depth, values=depth.values | {'fluid_pressure': gauge})]
    )
    top = yaml.safe_load(text)['depth']
    assert (top['unit'], top['atmospheric_pressure']) == ('Pa', 0.0)
    deep = depth.values | {'fluid_pressure': 101325.0 + 1e4 * np.linspace(10.0, 12.0, len(gauge))}
    text = guessed(tmp_path / 'deep', make, [imu, replace(depth, values=deep)])
    assert 'none at the surface' in text
    assert 'atmospheric_pressure' not in yaml.safe_load(text)['depth']
    shallow = depth.values | {'fluid_pressure': gauge / 50.0}
    text = guessed(tmp_path / 'shallow', make, [imu, replace(depth, values=shallow)])
    assert yaml.safe_load(text)['depth']['unit'] == 'FILL_IN'


def test_a_navsatfix_is_a_fix_whatever_its_name(columns: Columns, tmp_path: Path) -> None:
    """Without such a name in the graph, and without stamps: no delay of half a century."""
    make, (imu, dvl, depth, fixes, _) = columns
    named = replace(fixes, topic='/gnss/position')
    text = guessed(tmp_path / 'named', make, [imu, dvl, depth, named])
    assert [f['topic'] for f in yaml.safe_load(text)['fixes']] == ['/gnss/position']
    zero = with_stamps(named, np.zeros(len(named.log_ns), dtype=np.int64))
    text = guessed(tmp_path / 'zero', make, [imu, dvl, depth, zero])
    assert yaml.safe_load(text)['fixes'][0]['stamp'] == 'log'
    assert 'FILL IN time_offset_s: -DELAY' in text
    assert 'taken as the delay' not in text


def test_heights_of_fixes_where_nothing_else_measures_them(
    columns: Columns, tmp_path: Path
) -> None:
    """An IMU alone holds no height: without those of the fixes it is lost within minutes."""
    make, (imu, dvl, depth, fixes, _) = columns
    rising = fixes.values | {'altitude': np.arange(float(len(fixes.log_ns)))}
    varying = replace(fixes, values=rising)
    zero = replace(fixes, values=fixes.values | {'altitude': np.zeros(len(fixes.log_ns))})
    cases = {'both': ([depth, varying], 2), 'alone': ([varying], 3), 'none': ([zero], 2)}
    for name, (some, dimensions) in cases.items():
        text = guessed(tmp_path / name, make, [imu, dvl, *some])
        assert yaml.safe_load(text)['fixes'][0]['dimensions'] == dimensions
        assert ('nothing measures the height' in text) is (name == 'none')


def test_fixes_whose_heights_are_nan_are_fixes(columns: Columns, tmp_path: Path) -> None:
    """NavSatFix has NaN where the height is not known: their place is used all the same."""
    make, (imu, dvl, depth, fixes, _) = columns
    unknown = fixes.values | {'altitude': np.full(len(fixes.log_ns), np.nan)}
    text = guessed(tmp_path, make, [imu, dvl, depth, replace(fixes, values=unknown)])
    top = yaml.safe_load(text)
    assert [f['topic'] for f in top['fixes']] == [FIXES]
    assert top['fixes'][0]['dimensions'] == 2
    assert 'hold no position' not in text
    # The start cannot be from them: it is aligned.
    assert top['initial'] == {'from': 'values', 'heading_deg': 'FILL_IN'}


def test_of_two_vehicles_one_is_mapped_and_the_other_named(
    columns: Columns, tmp_path: Path
) -> None:
    make, (imu, dvl, depth, fixes, _) = columns
    mine = [replace(c, topic=f'/Alpha{c.topic}') for c in (imu, dvl, depth, fixes)]
    theirs = [replace(c, topic=f'/bravo{c.topic}') for c in (imu, dvl, depth, fixes)]
    # Of the other one alone there is a position that is a fix by its name.
    both = [*mine[:3], *theirs]
    for name, other, has_fixes in (('Alpha', 'bravo', False), ('bravo', 'Alpha', True)):
        choices = replace(KNOWN, vehicle=name)
        text = guessed(tmp_path / name, make, both, choices)
        top = yaml.safe_load(text)
        assert top['vehicle'] == name
        assert [top[k]['topic'] for k in ('imu', 'dvl', 'depth')] == [
            f'/{name}{c.topic}' for c in (imu, dvl, depth)
        ]
        assert ('fixes' in top) is has_fixes
        assert f'# {other} is another vehicle by its IMU; `polar map --vehicle {other}`' in text
        assert f'/{other}/' not in text
    with pytest.raises(ConfigError, match=f'charlie has no IMU in its namespace; .*{IMU}'):
        guessed(tmp_path / 'none', make, both, replace(KNOWN, vehicle='charlie'))


def test_an_imu_without_gravity_is_none(columns: Columns, tmp_path: Path) -> None:
    """Linear acceleration in place of specific force: no axes are guessed from its noise."""
    make, (imu, *_) = columns
    noise = np.random.default_rng(1).normal(0.0, 0.05, (len(imu.log_ns), 3))
    names = [f'linear_acceleration.{axis}' for axis in 'xyz']
    values = imu.values | dict(zip(names, noise.T, strict=True))
    text = guessed(tmp_path, make, [replace(imu, values=values)])
    top = yaml.safe_load(text)
    assert top['imu'] | {'topic': IMU, 'rotation': 'FILL_IN'} == top['imu']
    assert 'gravity was taken out' in text


def test_an_odometry_of_an_unknown_origin_is_no_start(columns: Columns, tmp_path: Path) -> None:
    """Fixes say where the vehicle is, an odometry in a frame of its own does not."""
    make, (imu, dvl, depth, fixes, truth) = columns
    odometry = replace(truth, topic='/odometry/filtered')
    text = guessed(tmp_path / 'both', make, [imu, dvl, depth, fixes, odometry])
    assert yaml.safe_load(text)['initial']['topic'] == FIXES
    assert '/odometry/filtered (nav_msgs/msg/Odometry, ' in text
    text = guessed(tmp_path / 'alone', make, [imu, dvl, depth, odometry])
    assert yaml.safe_load(text)['initial']['topic'] == '/odometry/filtered'


def test_an_ahrs_is_a_heading_beside_a_reference(columns: Columns, tmp_path: Path) -> None:
    """The reference gives the start; the orientation of the IMU goes on to be measured."""
    make, (imu, dvl, depth, fixes, truth) = columns
    turn = 0.5 * np.linspace(0.0, 1.0, len(imu.log_ns))  # about the vertical, of a level vehicle
    zero = np.zeros_like(turn)
    level = {f'linear_acceleration.{axis}': zero for axis in 'xy'}
    level |= {'linear_acceleration.z': zero - 9.81}
    quaternion = zip('xyzw', (zero, zero, np.sin(turn), np.cos(turn)), strict=True)
    values = imu.values | level | {f'orientation.{axis}': v for axis, v in quaternion}
    known = replace(imu.template, orientation_covariance=np.zeros(9))
    ahrs = replace(imu, values=values, template=known)
    top = yaml.safe_load(guessed(tmp_path / 'one', make, [ahrs, dvl, depth, fixes, truth]))
    heading = top['heading']
    assert (heading['topic'], heading['world'], heading['reference']) == (IMU, 'ned', 'FILL_IN')
    assert 'stamp' not in heading
    assert top['initial']['topic'] == TRUTH
    unstamped = with_stamps(ahrs, np.zeros(len(ahrs.log_ns), dtype=np.int64))
    top = yaml.safe_load(guessed(tmp_path / 'zero', make, [unstamped, dvl, depth, fixes, truth]))
    assert top['imu']['stamp'] == top['heading']['stamp'] == 'log'


def test_an_imu_with_a_clock_of_its_own(columns: Columns, tmp_path: Path) -> None:
    """Counted from its power-up: the others are not put on that clock, it is fitted to theirs."""
    make, (imu, dvl, depth, fixes, truth) = columns
    booted = with_stamps(imu, imu.log_ns - imu.log_ns[0] + 300 * S)
    later = [replace(c, log_ns=c.log_ns + DAY) for c in (booted, dvl, depth, fixes, truth)]
    now = [later[0], *(with_stamps(c, c.log_ns) for c in later[1:])]
    top = yaml.safe_load(guessed(tmp_path / 'own', make, now))
    assert top['imu']['clock'] == 'sensor'
    assert 'stamp' not in top['dvl']
    assert 'stamp' not in top['depth']
    top = yaml.safe_load(guessed(tmp_path / 'all', make, later))  # played and recorded again
    assert 'clock' not in top['imu']


def test_poses_that_nobody_turned_have_no_attitude(columns: Columns, tmp_path: Path) -> None:
    """A USBL's PoseStamped is level and ahead for ever: that is no heading to start with."""
    make, (imu, dvl, depth, _, truth) = columns
    level = {f'pose.pose.orientation.{axis}': np.zeros(len(truth.log_ns)) for axis in 'xyz'}
    level['pose.pose.orientation.w'] = np.ones(len(truth.log_ns))
    poses = replace(truth, topic='/usbl/pose', values=truth.values | level)
    text = guessed(tmp_path / 'level', make, [imu, dvl, depth, poses])
    assert (
        yaml.safe_load(text)['initial'] | {'heading_deg': 'FILL_IN'}
        == (yaml.safe_load(text)['initial'])
    )
    found = read_positions(open_source(tmp_path / 'level' / 'bag'), placed('/usbl/pose'))
    assert np.isnan(found.C_b_G).all()
    assert np.isfinite(found.r_e).all()
    turned = replace(truth, topic='/usbl/pose')
    text = guessed(tmp_path / 'turned', make, [imu, dvl, depth, turned])
    assert 'heading_deg' not in yaml.safe_load(text)['initial']


def placed(topic: str) -> PositionMapping:
    """Positions in east, north, up of the worlds' origin."""
    return PositionMapping(Stream(topic), Frame('enu', ORIGIN), np.eye(3))


@pytest.mark.parametrize(
    ('imu_class', 'claimed', 'sigma'),
    [
        ('vn100', 0.005, 0.03),
        ('vn100', 0.05, None),
        ('vn100', 0.0, 0.03),
        ('stim300', 0.005, None),
    ],
)
def test_pings_that_claim_too_much_for_the_gyros(
    columns: Columns, tmp_path: Path, imu_class: str, claimed: float, sigma: float | None
) -> None:
    """A file with nothing but its two lines filled in must not be too sure of the heading."""
    make, (imu, dvl, *_) = columns
    covariance = np.diag([claimed**2] * 3 + [0.0] * 3).ravel()
    inner = replace(dvl.template.twist, covariance=covariance)
    pings = replace(dvl, template=replace(dvl.template, twist=inner))
    choices = replace(KNOWN, imu=imu_class)
    top = yaml.safe_load(guessed(tmp_path, make, [imu, pings], choices))
    assert top['dvl'].get('sigma') == sigma


def test_a_dvl_by_the_name_of_its_make(columns: Columns, tmp_path: Path) -> None:
    """A twist of /a50 is its velocity; one of a command is listed, and not taken."""
    make, (imu, dvl, *_) = columns
    named, other = replace(dvl, topic='/a50/velocity'), replace(dvl, topic='/cmd_vel')
    text = guessed(tmp_path / 'make', make, [imu, named, other])
    assert yaml.safe_load(text)['dvl']['topic'] == '/a50/velocity'
    assert '# Topics with velocities that are not used above:' in text
    assert 'dvl' not in yaml.safe_load(guessed(tmp_path / 'none', make, [imu, other]))


def test_estimates_of_a_follower_are_no_measurements() -> None:
    """With its own depth as the depth sensor, a filter would only ever agree with itself."""
    kinds = {
        '/auv/nav/state': 'polar_nav_msgs/msg/NavState',
        '/auv/odometry/depth': 'polar_nav_msgs/msg/Depth',
        '/auv/odometry/now': 'nav_msgs/msg/Odometry',
        '/auv/depth/data': 'polar_nav_msgs/msg/Depth',
        '/ship/odometry': 'nav_msgs/msg/Odometry',
    }
    found = outputs_of([Topic(name, kind, 9) for name, kind in kinds.items()])
    assert found & kinds.keys() == {'/auv/nav/state', '/auv/odometry/depth', '/auv/odometry/now'}
