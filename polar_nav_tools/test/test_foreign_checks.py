"""Every kind of finding is provoked once, with its topic, stamp and number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_samples import (
    DEPTH,
    DVL,
    FIXES,
    IMU,
    MAPPING,
    TRUTH,
    Change,
    Message,
    engine_parameters,
    recording,
    restamped,
    write,
)

from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.section import Section
from polar_nav_ros.adapters.sensors import DepthRows, ImuRows
from polar_nav_tools.bags.finding import Finding, Severity
from polar_nav_tools.foreign.check_imu import check_imu
from polar_nav_tools.foreign.check_stamps import Times, check_spans, check_stamps
from polar_nav_tools.foreign.check_values import check_depth
from polar_nav_tools.foreign.findings import NAMES, Refused
from polar_nav_tools.foreign.load import Loaded, load
from polar_nav_tools.foreign.sources import open_source

S = 1_000_000_000
START = 1772323200 * S


def loaded(
    path: Path, changes: dict[str, Any] | None = None, accept: tuple[str, ...] = ()
) -> Loaded:
    """Load a foreign bag with parts of the mapping replaced."""
    top = yaml.safe_load(MAPPING) | {'parameters': engine_parameters()} | (changes or {})
    return load(open_source(path), mapping_file.from_section(Section('m.yaml', top)), accept)


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording without a fault."""
    return write(tmp_path_factory.mktemp('whole') / 'bag')


def found(
    path: Path, name: str, changes: dict[str, Any] | None = None, severity: str = 'SEVERE'
) -> Finding:
    """One finding by name; a severe one must refuse the run, and be accepted by name."""
    if Severity[severity] is Severity.SEVERE:
        with pytest.raises(Refused) as caught:
            loaded(path, changes)
        first = next(f for f in caught.value.findings if f.name == name)
        names = {f.name for f in caught.value.findings}
        again = loaded(path, changes, (*names, 'path_length'))  # follows from many faults
        assert first in again.findings
        assert any(name in line for line in caught.value.details)
    else:
        first = next(f for f in loaded(path, changes).findings if f.name == name)
    assert first.severity is Severity[severity]
    assert first.count > 0
    return first


def changed(tmp_path: Path, topic: str, change: Callable[[Message, int], Message | None]) -> Path:
    """Write the bag with the messages of one topic changed, by their number."""
    numbers: dict[str, int] = {}

    def one(message: Message) -> Message | None:
        k = numbers.setdefault(message[0], 0)
        numbers[message[0]] += 1
        return change(message, k) if message[0] == topic else message

    made: Change = one
    return write(tmp_path / 'changed', change=made)


def stamp_of(message: Message) -> int:
    """Stamp of a message [ns]."""
    stamp = message[3].header.stamp
    return int(stamp.sec) * S + int(stamp.nanosec)


def edit(message: Message, **values: Any) -> Message:
    """Return a message with other fields."""
    topic, kind, log_ns, m = message
    return topic, kind, log_ns, replace(m, **values)


def test_a_whole_recording_has_no_finding(whole: Path) -> None:
    """Nothing is wrong with the reference: a check that cries wolf is worth nothing."""
    assert [f for f in loaded(whole).findings if f.severity > Severity.NOTE] == []


def test_stamps_zero(tmp_path: Path) -> None:
    """Headers that nobody filled in; `stamp: log` is the way out."""
    path = changed(tmp_path, DVL, lambda m, _: restamped(m, 0))
    assert found(path, 'stamps_zero').topic == DVL
    top = yaml.safe_load(MAPPING)['dvl'] | {'stamp': 'log'}
    assert not [f for f in loaded(path, {'dvl': top}).findings if f.name == 'stamps_zero']


def test_one_stamp_that_is_zero(tmp_path: Path) -> None:
    """A driver that forgot one is warned of; a recording may begin at zero."""
    path = changed(tmp_path, DVL, lambda m, k: restamped(m, 0) if k == 70 else m)
    finding = found(path, 'stamps_zero', severity='WARNING')
    assert (finding.topic, finding.count) == (DVL, 1)
    assert len(loaded(path).inputs.dvl_stamps_ns) == 149
    two = changed(tmp_path / 'two', DVL, lambda m, k: restamped(m, 0) if k in (70, 90) else m)
    assert found(two, 'stamps_zero').count == 2
    steps = np.arange(200, dtype=np.int64) * S // 100
    assert list(check_stamps('/imu', steps, steps + START)) == []
    assert [f.name for f in check_stamps('/imu', steps[:5] * 0, steps[:5])] == ['stamps_zero']


def test_stamps_backwards(tmp_path: Path) -> None:
    """Two samples swapped; accepted, they are sorted."""
    path = changed(
        tmp_path, IMU, lambda m, k: restamped(m, stamp_of(m) - 50_000_000) if k == 700 else m
    )
    finding = found(path, 'stamps_backwards')
    assert finding.topic == IMU
    assert finding.value == pytest.approx(0.04)
    stamps = loaded(path, accept=('stamps_backwards',)).inputs.imu_stamps_ns
    assert (np.diff(stamps) >= 0).all()


@pytest.mark.parametrize(('every', 'severity'), [(1000, 'WARNING'), (4, 'SEVERE')])
def test_stamps_repeated(tmp_path: Path, every: int, severity: str) -> None:
    """A stamp twice now and then is a warning; a quarter of them is a broken driver."""
    path = changed(
        tmp_path,
        IMU,
        lambda m, k: restamped(m, stamp_of(m) - 10_000_000) if k % every == every - 1 else m,
    )
    assert found(path, 'stamps_repeated', severity=severity).topic == IMU


def test_stamps_jump(tmp_path: Path) -> None:
    """Stamps go ahead by an hour while the recording goes on."""
    path = changed(
        tmp_path, DEPTH, lambda m, k: restamped(m, stamp_of(m) + 3600 * S) if k >= 150 else m
    )
    finding = found(path, 'stamps_jump')
    assert finding.topic == DEPTH
    assert finding.value == pytest.approx(3600.1)
    assert finding.stamp_ns == stamp_at(DEPTH, 150) + 3600 * S


def stamp_at(topic: str, k: int) -> int:
    """Stamp of message k of a topic as recorded."""
    r = recording()
    return {IMU: r.imu, DVL: r.dvl, DEPTH: r.depth}[topic][k].stamp_ns


def test_gap(tmp_path: Path) -> None:
    """Nothing on a topic for five seconds is a warning."""
    path = changed(tmp_path, DVL, lambda m, k: None if 50 <= k < 80 else m)
    finding = found(path, 'gap', severity='WARNING')
    assert (finding.topic, finding.value) == (DVL, pytest.approx(6.2))


@pytest.mark.parametrize(('rate', 'severity'), [(1.01, 'WARNING'), (1.05, 'SEVERE')])
def test_stamps_drift(tmp_path: Path, rate: float, severity: str) -> None:
    """A clock that gains; a per cent and a second in all refuse."""

    def gain(message: Message, _: int) -> Message:
        stamp = stamp_of(message)
        return restamped(message, stamp + round((rate - 1.0) * (stamp - START)))

    path = changed(tmp_path, DEPTH, gain)
    finding = found(path, 'stamps_drift', severity=severity)
    assert finding.value == pytest.approx(rate - 1.0, rel=0.02)


def test_stamps_apart(tmp_path: Path) -> None:
    """A sensor on a clock of its own, and the offset that mends it."""
    path = changed(tmp_path, DVL, lambda m, _: restamped(m, stamp_of(m) - 1000 * S))
    finding = found(path, 'stamps_apart')
    assert finding.value == pytest.approx(-1000.0, abs=0.5)
    assert '`stamp: log` takes the log time, or `time_offset_s: 1000` ' in finding.text
    top = yaml.safe_load(MAPPING)['dvl'] | {'time_offset_s': 1000.0}
    assert len(loaded(path, {'dvl': top}).inputs.dvl_stamps_ns) == 150


def test_the_offset_that_is_told_has_all_its_digits() -> None:
    """Six days and 0.04 s, of every second message 20 ms more: the median, not the mean."""
    t = START + np.arange(400, dtype=np.int64) * S // 10
    behind = np.full(400, 514_944_040_000_000, dtype=np.int64)
    behind[::3] += 20_000_000
    other = Times('/dvl', t - behind, t)
    (finding,) = check_spans(Times('/imu', t, t), [other])
    assert '`time_offset_s: 514944.04` (median' in finding.text
    shifted = other._replace(stamps_ns=other.stamps_ns + 10 * S, offset_ns=10 * S)
    assert '`time_offset_s: 514944.04` (' in next(check_spans(Times('/imu', t, t), [shifted])).text
    # An IMU without stamps has its log times; one on the other clock, too, gives its own offset.
    assert '514944.04`' in next(check_spans(Times('/imu', 0 * t, t), [other])).text
    imu = Times('/imu', t - 100 * S, t)
    (finding,) = check_spans(imu, [other])
    assert '`time_offset_s: 514844.04`' in finding.text
    assert 'less that of the IMU' in finding.text
    assert '`stamp: log`' not in finding.text
    (finding,) = check_spans(Times('/imu', t, t), [other._replace(delayed=True)])
    assert 'the delay has to be taken off' in finding.text


def test_rate_low(tmp_path: Path) -> None:
    """An IMU at 10 Hz."""
    path = changed(tmp_path, IMU, lambda m, k: m if k % 10 == 0 else None)
    assert found(path, 'rate_low', severity='WARNING').value == pytest.approx(10.0, rel=0.01)


def test_not_finite(tmp_path: Path) -> None:
    """NaN in a few messages is a warning, in most of them refuses."""

    def spoil(message: Message, k: int) -> Message:
        nan = replace(message[3].turn_rate_deg, right=float('nan'))
        return edit(message, turn_rate_deg=nan) if k % 100 == 5 else message

    path = changed(tmp_path, IMU, spoil)
    finding = found(path, 'not_finite', severity='WARNING')
    assert (finding.topic, finding.count) == (IMU, 30)
    assert finding.stamp_ns == stamp_at(IMU, 5)


def test_stuck(tmp_path: Path) -> None:
    """The accelerometers repeat themselves for three seconds, the gyros do not."""
    held: list[Any] = []

    def hold(message: Message, k: int) -> Message:
        if k == 1000:
            held.append(message[3].specific_force_g)
        return edit(message, specific_force_g=held[0]) if 1000 <= k < 1300 else message

    finding = found(changed(tmp_path, IMU, hold), 'stuck')
    assert (finding.topic, finding.count) == (IMU, 300)
    assert finding.stamp_ns == stamp_at(IMU, 1000)
    assert finding.value == pytest.approx(2.99)


def test_a_depth_that_never_changes(tmp_path: Path) -> None:
    """Half a minute is short for a sensor at rest, and the whole of the recording."""
    held: list[Any] = []

    def hold(message: Message, _: int) -> Message:
        held.append(message[3].point)
        return edit(message, point=held[0])

    finding = found(changed(tmp_path, DEPTH, hold), 'stuck')
    assert (finding.topic, finding.count) == (DEPTH, 301)

    def half(message: Message, k: int) -> Message:
        return hold(message, k) if k < 150 else message

    names = {f.name for f in loaded(changed(tmp_path / 'half', DEPTH, half)).findings}
    assert 'stuck' not in names


@pytest.mark.parametrize(
    ('rate', 'force', 'text'),
    [
        (0.0, 0.0, 'the IMU is all zeros'),
        (0.01, 0.0, 'the specific force of the IMU is all zeros'),
        (0.0, 9.81, 'the rate of the IMU is all zeros'),
    ],
)
def test_imu_zero(rate: float, force: float, text: str) -> None:
    """Named as what it is, and no warning of NumPy's beside it."""
    n = 3000
    stamps = START + np.arange(n, dtype=np.int64) * S // 100
    noise = np.random.default_rng(5).normal(1.0, 0.01, (n, 3))
    rows = ImuRows('/imu', stamps, stamps, rate * noise, force * noise)
    (finding,) = check_imu(rows)
    assert (finding.name, finding.severity) == ('imu_zero', Severity.SEVERE)
    assert text in finding.text


def imu_mapping(**changes: Any) -> dict[str, Any]:
    """The IMU's part of the mapping, changed."""
    return {'imu': yaml.safe_load(MAPPING)['imu'] | changes}


def test_gravity_units(whole: Path) -> None:
    """G taken for m/s^2, and the sentence knows the unit."""
    finding = found(whole, 'gravity_units', imu_mapping(accel_unit='m/s^2'))
    assert finding.value == pytest.approx(1.0, rel=0.01)
    assert 'accel_unit: g' in finding.text


def test_gravity_sign(whole: Path) -> None:
    """Forward-right-down taken for forward-left-up."""
    finding = found(whole, 'gravity_sign', imu_mapping(rotation='flu'))
    assert finding.value == pytest.approx(-9.81, abs=0.03)


def test_gravity_direction(whole: Path) -> None:
    """An IMU on its side."""
    finding = found(whole, 'gravity_direction', imu_mapping(rotation='dfr'))
    assert abs(finding.value) < 0.1


def test_gyro_units(whole: Path) -> None:
    """Degrees taken for radians: gravity turns 57 times too much."""
    finding = found(whole, 'gyro_units', imu_mapping(gyro_unit='rad/s'))
    assert finding.value == pytest.approx(57.3, rel=0.2)
    assert 'gyro_unit: deg/s' in finding.text


def test_gyro_sign_and_rate_size() -> None:
    """A tumbling IMU whose gyros count the other way round; and one that spins too fast."""
    n = 6000
    t = np.arange(n) * 0.01
    roll = 0.3 * np.sin(0.5 * t)
    rate = 0.15 * np.cos(0.5 * t)
    f = 9.81 * np.column_stack([0.0 * t, np.sin(roll), np.cos(roll)])
    noise = np.random.default_rng(3).normal(0.0, 1e-4, (n, 3))
    stamps = START + np.round(t * S).astype(np.int64)
    right = np.column_stack([rate, 0.0 * t, 0.0 * t]) + noise
    for sign, names in ((1.0, set()), (-1.0, {'gyro_sign'})):
        rows = ImuRows('/imu', stamps, stamps, sign * right, f + noise)
        assert {x.name for x in check_imu(rows)} == names
    fast = ImuRows('/imu', stamps, stamps, right + np.array([0.0, 0.0, 6.0]), f + noise)
    assert 'rate_size' in {x.name for x in check_imu(fast)}


@pytest.mark.parametrize(
    ('name', 'value'),
    [('covariance_zero', 0.0), ('covariance_not_finite', np.nan), ('covariance_negative', -2.0)],
)
def test_covariances(tmp_path: Path, name: str, value: float) -> None:
    """Zero, NaN and negative covariances refuse; `sigma` states one."""

    def spoil(message: Message, _: int) -> Message:
        P = np.diag([value] * 3).ravel()
        return edit(message, velocity_covar=P)

    path = changed(tmp_path, DVL, spoil)
    assert found(path, name).topic == DVL
    top = yaml.safe_load(MAPPING)['dvl'] | {'sigma': 0.01}
    P = loaded(path, {'dvl': top}).inputs.dvl_covariance_m
    assert np.allclose(P, 1e-4 * np.eye(3), atol=1e-18)


def test_covariances_of_fixes(tmp_path: Path) -> None:
    """The same for position fixes, whose covariance stands in a 6 by 6 matrix."""

    def spoil(message: Message, _: int) -> Message:
        return edit(message, pose=replace(message[3].pose, covariance=np.zeros(36)))

    path = changed(tmp_path, FIXES, spoil)
    assert found(path, 'covariance_zero').topic == FIXES


def test_velocity(tmp_path: Path, whole: Path) -> None:
    """Millimetres per second taken for metres, and pings without bottom lock."""

    def in_mm(message: Message, k: int) -> Message:
        v = message[3].velocity
        v = replace(v, x=1e3 * v.x, y=1e3 * v.y, z=1e3 * v.z)
        return edit(message, velocity=v, num_good_beams=1 if k < 30 else 4)

    path = changed(tmp_path, DVL, in_mm)
    finding = found(path, 'velocity_size')
    assert finding.value > 2500.0
    assert 'mm/s' in finding.text
    assert found(path, 'velocity_invalid', dvl_in('mm/s'), 'WARNING').count == 30
    assert loaded(whole).inputs.dvl_valid.all()


def test_pings_relative_to_the_water(tmp_path: Path) -> None:
    """Taken where the mapping states that they are what is wanted, and only there."""
    path = changed(tmp_path, DVL, lambda m, _: edit(m, velocity_mode=2))
    assert not loaded(path).inputs.dvl_valid.any()
    top = yaml.safe_load(MAPPING)['dvl'] | {'reference': 'water'}
    assert loaded(path, {'dvl': top}).inputs.dvl_valid.all()


def dvl_in(unit: str) -> dict[str, Any]:
    """The DVL's part of the mapping with a unit."""
    return {'dvl': yaml.safe_load(MAPPING)['dvl'] | {'unit': unit}}


def test_depth_and_pressure(whole: Path) -> None:
    """A height taken for a depth; metres taken for pascals."""
    depth = yaml.safe_load(MAPPING)['depth']
    finding = found(whole, 'depth_size', {'depth': depth | {'positive': 'down'}})
    assert 'positive: up' in finding.text
    assert finding.value == pytest.approx(-99.3, abs=1.0)
    assert found(whole, 'pressure_size', {'depth': depth | {'unit': 'Pa'}}).topic == DEPTH


def test_a_vehicle_in_the_air() -> None:
    """Heights of some metres taken for depths, and gauge pressures for absolute ones."""
    stamps_ns = np.arange(300, dtype=np.int64)
    zero, ones = np.zeros(300), np.ones(300)

    def told(depth: Any, pressure: Any = None) -> list[str]:
        rows = DepthRows('/d', stamps_ns, stamps_ns, depth, ones, ones > 0.0, pressure)
        return [f.text for f in check_depth(rows) if f.name == 'depth_in_air']

    dive = np.linspace(0.0, 8.0, 300)
    assert told(dive) == told(zero - 0.5) == []
    assert '`positive: up`' in told(-dive)[0]
    assert 'atmospheric_pressure: 0' in told(dive - 10.06, 1e4 * dive)[0]


def test_positions(tmp_path: Path, whole: Path) -> None:
    """Metres in a local frame taken for ECEF, and messages that are NaN."""
    top = yaml.safe_load(MAPPING)
    fix = {**top['fixes'][0], 'frame': 'earth'}
    assert found(whole, 'position_size', {'fixes': [fix]}).topic == FIXES

    def spoil(message: Message, k: int) -> Message:
        if k >= 3:
            return message
        pose = message[3].pose.pose
        point = replace(pose.position, x=float('nan'))
        outer = replace(message[3].pose, pose=replace(pose, position=point))
        return edit(message, pose=outer)

    path = changed(tmp_path, FIXES, spoil)
    assert found(path, 'position_invalid', severity='WARNING').count == 3
    assert len(loaded(path).inputs.fixes) == len(recording().fixes) - 3


def test_fixes_without_any_position(tmp_path: Path) -> None:
    """Nothing can be fused: another topic, or none."""

    def spoil(message: Message, _: int) -> Message:
        pose = message[3].pose.pose
        point = replace(pose.position, x=float('nan'))
        return edit(message, pose=replace(message[3].pose, pose=replace(pose, position=point)))

    finding = found(changed(tmp_path, FIXES, spoil), 'position_invalid')
    assert '13 of 13 messages hold no position' in finding.text


def test_fixes_of_another_clock(whole: Path) -> None:
    """Six days are no delay; told with all digits."""
    top = yaml.safe_load(MAPPING)['fixes'][0]
    finding = found(whole, 'fix_clock', {'fixes': [top | {'time_offset_s': -514944.0}]})
    assert finding.topic == FIXES
    assert finding.value == pytest.approx(514944.0 + 5.0, abs=5.0)
    assert '(5.96 days)' in finding.text


def test_times_of_fixes(whole: Path) -> None:
    """Received before valid, older than the filter takes, and with no delay at all."""
    top = yaml.safe_load(MAPPING)['fixes'][0]
    assert found(whole, 'fix_from_future', {'fixes': [top | {'time_offset_s': 9.0}]}).value > 1.0
    late = {'fixes': [top | {'delay_s': 90.0}]}
    assert found(whole, 'fix_late', late, 'WARNING').value == pytest.approx(90.0)
    none = {'fixes': [top | {'delay_s': 0.0}]}
    assert found(whole, 'fix_not_delayed', none, 'NOTE').topic == FIXES


def test_a_clock_a_little_ahead_is_no_future(whole: Path) -> None:
    """As live: what comes at most 0.1 s before it is valid came when it was."""
    plain = loaded(whole).inputs.fixes
    least = min(f.receive_ns - f.validity_ns for f in plain)
    top = yaml.safe_load(MAPPING)['fixes'][0]
    for ahead_s, left_s in ((0.09, 0.0), (0.11, 0.11)):
        changes = {'fixes': [top | {'time_offset_s': 1e-9 * least + ahead_s}]}
        fixes = loaded(whole, changes, ('fix_from_future',)).inputs.fixes
        earliest = min(f.receive_ns - f.validity_ns for f in fixes)
        assert 1e-9 * earliest == pytest.approx(-left_s, abs=1e-6)


def test_what_is_not_stated(whole: Path) -> None:
    """The noise of the IMU is asked for; a reference without attitude is told of."""
    params = {k: v for k, v in engine_parameters().items() if k != 'gyro_bias_sigma'}
    names = {f.name for f in loaded(whole, {'parameters': params}).findings}
    assert 'noise_not_stated' in names
    truth = yaml.safe_load(MAPPING)['fixes'][0]
    del truth['source']
    other = {'truth': {**truth, 'topic': DEPTH, 'frame': 'ned'}}
    names = {f.name for f in loaded(whole, other, ('path_length',)).findings}
    assert 'truth_attitude' in names
    assert TRUTH != FIXES


def test_every_name_is_documented_and_tested() -> None:
    """A finding that no test provokes may never be found."""
    here = Path(__file__)
    names = (here.name, *(f'test_foreign_{part}.py' for part in ('csv', 'initial', 'user')))
    text = ''.join((here.parent / name).read_text() for name in names)
    assert [name for name in NAMES if f"'{name}'" not in text] == []
    docs = (here.parents[2] / 'docs' / 'your-bags.md').read_text()
    assert [name for name in NAMES if f'`{name}`' not in docs] == []
