"""What a new user meets: a guessed mapping, what is left to fill in, and what a run says of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_worlds import (
    DEPTH,
    DVL,
    DVL_LEVER_B,
    FIXES,
    IMU,
    ORIGIN,
    TRUTH,
    Column,
    Recorder,
    aiding_columns,
    imu_column,
    mapping,
    stamps_of,
    truth_of,
    write_columns,
)
from mcap.writer import Writer

from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters import mapping_file, rotations
from polar_nav_ros.adapters.section import Section
from polar_nav_tools.bags import open_bag
from polar_nav_tools.foreign.candidates import vehicle
from polar_nav_tools.foreign.guess import guess
from polar_nav_tools.foreign.guess_noise import Choices
from polar_nav_tools.foreign.hindsight import tried_axes
from polar_nav_tools.foreign.load import load
from polar_nav_tools.foreign.mcap_records import log_times, topic_columns, topic_records
from polar_nav_tools.foreign.replay import ForeignRun, replay
from polar_nav_tools.foreign.sources import open_source, read_table
from polar_nav_tools.foreign.turns import turns

DURATION_S = 240.0
KNOWN = Choices(imu='stim300', dvl='workhorse_1200', reference='bottom')
Change = Callable[[dict[str, Any]], None]


@pytest.fixture(scope='module')
def columns() -> tuple[Recorder, list[Column]]:
    """Four minutes of everything."""
    truth, make = truth_of(DURATION_S), Recorder()
    imu = imu_column(make, truth, stamps_of(truth, 0.0, DURATION_S, 0.01))
    return make, [imu, *aiding_columns(make, truth, 0.0, DURATION_S)]


@pytest.fixture(scope='module')
def bag(columns: tuple[Recorder, list[Column]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of it, as MCAP."""
    return write_columns(tmp_path_factory.mktemp('user') / 'bag', *columns)


@pytest.fixture(scope='module')
def without_reference(
    columns: tuple[Recorder, list[Column]], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """As most recordings are, as sqlite3."""
    make, some = columns
    folder = tmp_path_factory.mktemp('user') / 'bag'
    return write_columns(folder, make, [c for c in some if c.topic != TRUTH], 'sqlite3')


def run(bag: Path, top: dict[str, Any]) -> ForeignRun:
    """Replay by a mapping."""
    return replay(open_source(bag), mapping_file.from_section(Section('m', top)))


def told(done: ForeignRun) -> dict[str, str]:
    """Findings of the run itself."""
    return {f.name: f.text for f in done.findings if f.name.endswith('_misfit')}


@pytest.mark.slow
def test_a_right_mapping_is_told_nothing(bag: Path) -> None:
    """No finding where everything fits."""
    done = run(bag, mapping())
    assert done.findings == ()
    assert done.verdicts == {'FUSED': 12}


@pytest.mark.slow
@pytest.mark.parametrize('rotation', ['flu', 'rfu', 'bld'])
def test_axes_of_a_dvl_that_do_not_fit_are_told_with_those_that_do(
    bag: Path, rotation: str
) -> None:
    """Nothing in its numbers alone says that they are wrong."""
    top = mapping()
    top['dvl']['rotation'] = rotation
    said = told(run(bag, top))
    assert '% were refused by the gate' in said['dvl_misfit']
    assert '`rotation: frd` fits' in said['dvl_misfit']
    if 'fixes_misfit' in said:
        assert 'put the DVL right first' in said['fixes_misfit']


@pytest.mark.slow
def test_a_dvl_that_is_turned_by_45_degrees(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """As many are mounted: told as it has to stand in the mapping."""
    make, (imu, dvl, *others) = columns
    names = [f'twist.twist.linear.{axis}' for axis in 'xyz']
    v_frd = np.column_stack([dvl.values[name] for name in names])
    v_s = v_frd @ rotations.named('frd').T @ rotations.from_rpy_deg((180, 0, -45))
    values = {**dvl.values, **dict(zip(names, v_s.T, strict=True))}
    bag = write_columns(tmp_path / 'bag', make, [imu, replace(dvl, values=values), *others])
    said = told(run(bag, mapping()))
    assert '`rotation: {rpy_deg: [180, 0, -45]}` fits' in said['dvl_misfit']
    top = mapping()
    top['dvl']['rotation'] = yaml.safe_load('{rpy_deg: [180, 0, -45]}')
    assert told(run(bag, top)) == {}


@pytest.mark.slow
def test_a_lever_arm_that_was_forgotten(bag: Path) -> None:
    """Here axes are right, and the turns show where it is."""
    top = mapping()
    del top['dvl']['lever_b']
    done = run(bag, top)
    (lever,) = (f for f in done.findings if f.name == 'dvl_lever')
    assert '`lever_b` x is -0.4' in lever.text
    assert lever.value == pytest.approx(DVL_LEVER_B[0], abs=0.1)
    assert 'See the lever arm or latency that the turns show' in told(done)['dvl_misfit']
    stated, others = tried_axes(done.loaded, done.loaded.params)
    assert others['frd'] == pytest.approx(stated, rel=1e-9)


@pytest.mark.slow
def test_a_dvl_that_is_late(bag: Path) -> None:
    """Its age is told, with the offset that mends it."""
    top = mapping()
    top['dvl']['time_offset_s'] = 0.4
    (late,) = (f for f in run(bag, top).findings if f.name == 'dvl_lever')
    assert 'pings are 0.4' in late.text
    assert 'add -0.4' in late.text
    assert '`lever_b`' not in late.text


@pytest.mark.slow
def test_turns_show_lever_arm_and_latency_within_their_sigmas(bag: Path) -> None:
    """Whatever the biases of the gyros are: a slow turn of 0.6 deg/s is taken off."""
    loaded = load(open_source(bag), mapping_file.from_section(Section('m', mapping())))
    x = loaded.inputs
    late_ns = 300_000_000
    for bias, lever_b, lag_ns in ((0.0, (0.0, 0.0, -0.3), late_ns), (0.01, DVL_LEVER_B, 0)):
        changed = replace(
            x, omega_ib_b=x.omega_ib_b + bias, dvl_stamps_ns=x.dvl_stamps_ns + lag_ns
        )
        found = turns(changed, np.array(lever_b))
        assert found is not None
        off = np.subtract(DVL_LEVER_B, lever_b)[:2] - found.lever_b
        assert (np.abs(off) < 4.0 * found.lever_sigma + 0.02).all()
        assert abs(found.lag_s - lag_ns * 1e-9) < 4.0 * found.lag_sigma
        assert found.lever_sigma.max() < 0.05
        assert found.lag_sigma < 0.03
    # A recording without a turn says nothing of x.
    straight = replace(x, imu_stamps_ns=x.imu_stamps_ns[:100], omega_ib_b=x.omega_ib_b[:100])
    assert turns(replace(straight, f_b=x.f_b[:100]), np.zeros(3)) is None


@pytest.mark.slow
def test_an_imu_of_a_cheaper_class(columns: tuple[Recorder, list[Column]], tmp_path: Path) -> None:
    """What `polar map` wrote for years: the noise of a tactical IMU, 100 times too good."""
    make, (imu, *others) = columns
    rng = np.random.default_rng(11)
    values = dict(imu.values)
    for name in values:
        if name.startswith('angular_velocity'):
            values[name] = values[name] + rng.normal(0.0, 5e-3, len(values[name])) + 4e-3
        elif name.startswith('linear_acceleration'):
            values[name] = values[name] + rng.normal(0.0, 0.05, len(values[name])) + 0.2
    bag = write_columns(tmp_path / 'bag', make, [replace(imu, values=values), *others])
    said = told(run(bag, mapping()))['dvl_misfit']
    assert 'With the noise of the IMU 100 times as large' in said
    assert 'see `noise`' in said


@pytest.mark.slow
def test_depths_and_fixes_that_do_not_fit(bag: Path) -> None:
    """Both with the numbers that lead on."""
    top = mapping()
    top['parameters'] |= {'sea_surface_height': 3.0}
    said = told(run(bag, top))
    assert set(said) == {'depth_misfit'}
    assert (
        'By the start the depth is 103.00 m, the first that was measured is 99.'
        in (said['depth_misfit'])
    )
    top = mapping()
    top['fixes'][0] |= {'time_offset_s': -30.0}
    said = told(run(bag, top))
    assert set(said) == {'fixes_misfit'}
    assert 'time_offset_s' in said['fixes_misfit']


@pytest.mark.slow
def test_from_a_guess_to_a_good_run(bag: Path) -> None:
    """What is marked, filled in; everything else as it was guessed."""
    text = guess(open_source(bag), KNOWN)
    top = yaml.safe_load(text)
    assert top['vehicle'] == 'auv'
    assert top['imu']['rotation'] == top['dvl']['rotation'] == 'frd'
    assert 'the messages name frame dvl_frd' in text
    assert [top[role]['topic'] for role in ('imu', 'dvl', 'depth', 'truth')] == [
        IMU,
        DVL,
        DEPTH,
        TRUTH,
    ]
    navsat = {'topic': FIXES, 'type': 'sensor_msgs/msg/NavSatFix', 'dimensions': 2}
    assert top['fixes'] == [navsat]
    assert 'recorded 8 s after their stamps' in text
    with pytest.raises(ConfigError, match=r'initial: frame: is still to be filled in: geodetic, '):
        mapping_file.from_section(Section('m', top))
    known = mapping()
    for role in ('initial', 'truth'):
        top[role] |= {'frame': 'enu', 'origin': known[role]['origin']}
    for role in ('dvl', 'depth'):
        top[role]['lever_b'] = known[role]['lever_b']
    top['fixes'][0]['transponder_lever_b'] = known['fixes'][0]['transponder_lever_b']
    done = run(bag, top)
    assert told(done) == {}
    assert done.verdicts == {'FUSED': 12}


@pytest.mark.slow
def test_a_start_from_the_first_fix(without_reference: Path) -> None:
    """Without a reference the first fix tells where; it is not used a second time."""
    text = guess(open_source(without_reference), KNOWN)
    top = yaml.safe_load(text)
    assert top['initial'] == {'from': 'topic', 'topic': FIXES, 'heading_deg': 'FILL_IN'}
    says = r'initial: heading_deg: is still to be filled in: a number \[deg\]'
    with pytest.raises(ConfigError, match=says):
        mapping_file.from_section(Section('m', top))
    truth = truth_of(DURATION_S)
    first = truth.state(truth.start_ns + 20 * 10**9)
    grid_heading = float(np.degrees(np.pi / 2 - np.arctan2(first.C_b_G[1, 0], first.C_b_G[0, 0])))
    known = mapping()
    top['initial'] |= {'grid_heading_deg': grid_heading, 'heading_deg': None}
    for role in ('dvl', 'depth'):
        top[role] = known[role]
    top['fixes'] = known['fixes']
    done = run(without_reference, top)
    assert done.loaded.start.stamp_ns == truth.start_ns + 20 * 10**9
    assert done.loaded.inputs.fixes[0].validity_ns == truth.start_ns + 40 * 10**9
    assert done.verdicts == {'FUSED': 11}
    last = done.estimates.rows(slice(-1, None))
    assert np.linalg.norm(last.r_e[0] - truth.state(int(last.stamp_ns[0])).r_e) < 5.0


def test_names_and_frames_that_are_guessed(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """A sensor is no vehicle; numbers as large as the earth are of its centre."""
    make, some = columns
    imu, dvl, _, _, reference = (thin(c) for c in some)
    lat, lon, _ = np.radians(ORIGIN)
    values = dict(reference.values)
    outwards = (np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat))
    for axis, r in zip('xyz', outwards, strict=True):
        values[f'pose.pose.position.{axis}'] = np.full(len(reference.log_ns), 6.36e6 * r)
    frame = replace(dvl.template, header=make.header('dvl_link'))
    chosen = [
        replace(imu, topic='/imu/data'),
        replace(dvl, template=frame),
        replace(reference, values=values),
    ]
    source = open_source(write_columns(tmp_path / 'bag', make, chosen))
    text = guess(source)
    top = yaml.safe_load(text)
    assert top['vehicle'] == 'vehicle'
    assert vehicle(source.topics[DVL]) == 'auv'
    assert top['dvl']['rotation'] == 'flu'
    assert 'not in the data: FILL IN, frd where z points down' in text
    assert top['truth'] == {'topic': TRUTH, 'frame': 'earth'}


def thin(c: Column) -> Column:
    """The first hundred messages."""
    return replace(c, log_ns=c.log_ns[:100], values={n: v[:100] for n, v in c.values.items()})


def test_one_topic_of_an_mcap_is_read_as_by_the_general_reader(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """Log times, bytes and columns, with messages of two lengths and a text that changes."""
    make, some = columns
    longer = replace(thin(some[1]), log_ns=thin(some[1]).log_ns + 1)
    longer = replace(
        longer, template=replace(longer.template, header=make.header('another_frame'))
    )
    bag = open_bag(write_columns(tmp_path / 'bag', make, [thin(c) for c in some] + [longer]))
    for topic in (IMU, DVL, FIXES):
        expected = [(log_ns, data) for _, log_ns, data in bag.messages([topic])]
        assert list(topic_records(bag, topic)) == expected
        assert log_times(bag, topic).tolist() == [log_ns for log_ns, _ in expected]
    assert len({len(data) for _, data in topic_records(bag, DVL)}) == 2
    wanted = ('angular_velocity.x', 'angular_velocity.y', 'angular_velocity.z', 'header.frame_id')
    quick = topic_columns(bag, IMU, wanted, [wanted[:3]])
    assert quick is not None
    sent = np.column_stack([some[0].values[name][:100] for name in wanted[:3]])
    assert np.array_equal(quick[wanted[0]], sent)
    assert set(quick['header.frame_id']) == {'imu_frd'}
    # Texts that change, and fields that are not there, are left to the general reader.
    assert topic_columns(bag, DVL, ('twist.twist.linear.x', 'header.frame_id'), []) is None
    assert topic_columns(bag, IMU, ('angular_velocity.w',), []) is None
    table = read_table(open_source(bag.path), DVL, ('twist.twist.linear.x', 'header.frame_id'))
    assert set(table.columns['header.frame_id']) == {'dvl_frd', 'another_frame'}


def test_log_times_are_not_publish_times(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """A recorder that was late: both stand side by side in the record."""
    make, some = columns
    imu = thin(some[0])
    path = tmp_path / 'late.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        text = make.store.generate_msgdef(imu.kind, ros_version=2)[0].encode()
        schema = writer.register_schema(imu.kind, 'ros2msg', text)
        channel = writer.register_channel(IMU, 'cdr', schema)
        for log_ns, data in zip(imu.log_ns.tolist(), make.serialize(imu), strict=True):
            writer.add_message(channel, log_ns + 70_000_000, data, publish_time=log_ns)
        writer.finish()
    source = open_source(path)
    late = (imu.log_ns + 70_000_000).tolist()
    assert read_table(source, IMU, ('header.stamp.sec',)).log_ns.tolist() == late
    assert [log_ns for log_ns, _ in source.records(IMU)] == late
