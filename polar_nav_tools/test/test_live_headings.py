"""Headings of an AHRS by a mapping file: live, replayed and from a recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import test_live_sources as live
import yaml
from foreign_worlds import (
    IMU,
    Column,
    Recorder,
    aiding_columns,
    imu_column,
    rows_of,
    stamps_of,
    truth_of,
    write_columns,
    xyz,
)
from scipy.spatial.transform import Rotation

from polar_nav_core.engine.events import HeadingSample
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import convergence, ecef_to_grid
from polar_nav_ros.adapters import mapping_file, rotations
from polar_nav_ros.adapters.fixes import fixes_of
from polar_nav_ros.adapters.headings import headings_of
from polar_nav_ros.adapters.live import Sources, Taken
from polar_nav_ros.adapters.mapping import HeadingMapping, Stream
from polar_nav_ros.adapters.position import positions_of
from polar_nav_ros.adapters.rows import Rows
from polar_nav_tools.foreign.load import load
from polar_nav_tools.foreign.sources import open_source
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.verification import verify

pytestmark = pytest.mark.slow

AHRS = '/ahrs/data'
HEADING = {
    'topic': AHRS,
    'type': 'sensor_msgs/msg/Imu',
    'rotation': 'frd',
    'reference': 'true',
    'bias_sigma_deg': 2.0,
}
GNSS = {
    'topic': '/gnss/fix',
    'type': 'sensor_msgs/msg/NavSatFix',
    'sigma': [2.0, 3.0],
    'antenna_lever_b': [1.0, 0.0, 0.5],
}


def true_heading(state: Any) -> Any:
    """Heading of base_link, clockwise from true north, of true states [rad]."""
    own = np.arctan2(state.C_b_G[:, 0, 0], state.C_b_G[:, 1, 0])
    return np.asarray(own + convergence(state.lat, state.lon))


def with_orientation(column: Column, truth: Any, world: str) -> Column:
    """An IMU's messages with the orientation of its forward-right-down axes."""
    s = truth.state(column.log_ns)
    h = true_heading(s)
    C_G_n = np.zeros((len(h), 3, 3))  # grid axes to east, north, up of the place
    angle = convergence(s.lat, s.lon)
    C_G_n[:, 0, 0] = C_G_n[:, 1, 1] = np.cos(angle)
    C_G_n[:, 0, 1], C_G_n[:, 1, 0] = np.sin(angle), -np.sin(angle)
    C_G_n[:, 2, 2] = 1.0
    C_s_n = C_G_n @ s.C_b_G @ rotations.named('frd')
    if world == 'ned':
        C_s_n = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]) @ C_s_n
    column.template.orientation_covariance = np.zeros(9)
    column.values.update(xyz('orientation', Rotation.from_matrix(C_s_n).as_quat(), 'xyzw'))
    return column


def world_of(topic: str, world: str = 'enu') -> tuple[Any, list[Column], dict[str, Any]]:
    """Truth, messages of a vehicle with an AHRS at 10 Hz or in its IMU, and the mapping."""
    truth, make = truth_of(120.0), Recorder()
    columns = [imu_column(make, truth, stamps_of(truth, 0.0, 40.0, 0.01))]
    columns += aiding_columns(make, truth, 0.0, 40.0)
    if topic == IMU:
        with_orientation(columns[0], truth, world)
    else:
        own = imu_column(make, truth, stamps_of(truth, 0.0, 40.0, 0.1), topic=topic)
        columns.append(with_orientation(own, truth, world))
    _, top = live.world()
    top['heading'] = HEADING | {'topic': topic, 'world': world}
    return truth, columns, top


class Wire(live.Wire):
    """A wire on which several may hear one topic."""

    def subscribe(self, _kind: Any, topic: str, callback: Any, **_options: Any) -> Any:
        before = self.callbacks.get(topic)

        def both(data: bytes) -> None:
            if before is not None:
                before(data)
            callback(data)

        return super().subscribe(_kind, topic, both)


@pytest.mark.parametrize('topic', [AHRS, IMU])
def test_live_equals_replay_with_headings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, topic: str
) -> None:
    """An AHRS on a topic of its own, and the orientation in the very messages of the IMU."""
    monkeypatch.setattr(live, 'Wire', Wire)
    _, columns, top = world_of(topic)
    heard = {c['topic'] for c in (top['imu'], top['dvl'], top['depth'], *top['fixes'])} | {topic}
    rows = [row for row in rows_of(Recorder(), columns) if row[0] in heard]
    path = live.sail(tmp_path / 'bag', rows, top)
    result = verify(path)
    assert result.ok, result.difference
    assert not result.problems
    taken = replay(path).taken
    assert taken['/auv/heading/data'] == (len(columns[0].log_ns) if topic == IMU else 400)


@pytest.mark.parametrize('world', ['enu', 'ned'])
def test_orientations_are_true_headings_live_and_offline(tmp_path: Path, world: str) -> None:
    truth, columns, top = world_of(AHRS, world)
    make = Recorder()
    path = write_columns(tmp_path / 'bag', make, columns)
    parsed = mapping_file.parse(yaml.safe_dump(top), 'mapping')
    inputs = load(open_source(path), parsed).inputs
    state = truth.state(inputs.heading_stamps_ns)
    off = np.angle(np.exp(1j * (inputs.headings - true_heading(state))))
    assert len(inputs.headings) > 390
    assert np.abs(off).max() < 1e-6
    assert np.abs(inputs.heading_up_b - state.C_b_G[:, 2]).max() < 1e-6
    source = Sources(parsed, live.params_of(top)).of('heading/data')
    assert source is not None
    k = 0
    for topic, log_ns, data in rows_of(make, columns):
        if topic == AHRS:
            message = make.store.deserialize_cdr(data, 'sensor_msgs/msg/Imu')
            if not source.bound:
                source.bind(message, {})
            stamp_ns = source.own_stamp_ns(message, log_ns)
            event = source.event(Taken(message, log_ns, stamp_ns), k)
            assert isinstance(event, HeadingSample)
            if k < len(inputs.headings):
                live.same(event, inputs.heading_sample(k))
            k += 1


def test_messages_without_an_orientation_hold_nothing() -> None:
    xyzw = np.array([[0.0, 0.0, 0.0, 1.0]] * 3)
    xyzw[1] = 0.0
    unknown = np.zeros((3, 9))
    unknown[2, 0] = -1.0
    stamps = np.arange(3)
    rows = Rows('/a', 'x', stamps, stamps, {'attitude': xyzw, 'covariance': unknown}, {})
    found = headings_of(rows, HeadingMapping(Stream('/a'), np.eye(3)))
    assert np.isfinite(found.heading).tolist() == [True, False, False]
    assert found.heading[0] == pytest.approx(np.pi / 2)  # along east


def test_a_plain_heading_has_a_unit_and_a_sense() -> None:
    stamps = np.arange(1)
    rows = Rows('/a', 'x', stamps, stamps, {'heading': np.array([90.0])}, {})
    for scale, found in ((np.pi / 180.0, np.pi / 2), (-np.pi / 180.0, -np.pi / 2)):
        one = headings_of(rows, HeadingMapping(Stream('/a'), np.eye(3), 'enu', scale))
        assert one.heading[0] == pytest.approx(found)
        assert np.isnan(one.up_b).all()


@pytest.mark.parametrize(
    ('changes', 'said'),
    [
        ({'reference': None}, 'reference: is missing: one of true, magnetic, grid, arbitrary'),
        ({'reference': 'magnetic'}, 'declination_applied_deg: is missing'),
        ({'world': 'nwu'}, "'nwu' is none of enu, ned"),
    ],
)
def test_what_a_heading_counts_from_must_be_stated(changes: dict[str, Any], said: str) -> None:
    _, top = live.world()
    top['heading'] = {k: v for k, v in (HEADING | changes).items() if v is not None}
    with pytest.raises(ConfigError, match='heading') as caught:
        mapping_file.parse(yaml.safe_dump(top), 'mapping')
    assert said in str(caught.value)


def test_headings_and_slow_errors_of_fixes_exclude_one_another() -> None:
    _, top = live.world()
    top['heading'] = HEADING
    packets = {'topic': '/acomms/rx', 'type': 'polar_nav_msgs/msg/AcousticPacket'}
    modem = {'topic': '/modem', 'fields': {'payload': 'data'}}
    slow = {**top['fixes'][0], 'slow_sigma': 2.0, 'correlation_s': 60.0}
    for fix, said in (
        (packets, 'error of the leader'),
        (modem, 'error of the leader'),
        (slow, r'slow error of the fixes \(slow_sigma\)'),
    ):
        with pytest.raises(ConfigError, match=said):
            mapping_file.parse(yaml.safe_dump(top | {'fixes': [fix]}), 'mapping')


def test_the_word_true_may_stand_without_quotes() -> None:
    _, top = live.world()
    text = yaml.safe_dump(top) + '\nheading: {topic: /ahrs, reference: true}\n'
    assert mapping_file.parse(text, 'mapping').params['heading_reference'] == 'true'


def test_all_errors_of_a_fix_of_an_antenna_apply() -> None:
    """Sigma, slow error, antenna; coth of all of it where the whole error is alike."""
    _, top = live.world()
    gnss = GNSS | {'delay_sigma_s': 0.2, 'correlation_s': 10.0}
    top['fixes'] = [{**top['fixes'][0], 'transponder_lever_b': [0.0, 0.0, -0.5]}]
    stamps = np.array([1_000_000_000, 2_000_000_000])
    values = {'geodetic': np.array([[80.0, 120.0, 10.0]] * 2), 'status': np.array([0, 0])}
    rows = Rows('/gnss/fix', gnss['type'], stamps, stamps, values, {})
    text = yaml.safe_dump(top | {'fixes': [*top['fixes'], gnss]})
    mapping = mapping_file.parse(text, 'mapping').fixes[1]
    first, second = fixes_of(mapping, positions_of(rows, mapping.position))
    np.testing.assert_allclose(second.covariance_e, first.covariance_e / np.tanh(0.05), rtol=1e-9)
    C_e_G = ecef_to_grid(first.r_e)
    stated = np.diag([4.0 + 0.5, 4.0 + 0.5, 9.0 + 0.02])
    np.testing.assert_allclose(C_e_G @ first.covariance_e @ C_e_G.T, stated, atol=1e-6)
    assert first.delay_sigma == 0.2
    slow = replace(mapping, correlation_s=0.0, slow_sigma=1.0)
    alike = fixes_of(slow, positions_of(rows, slow.position))
    stated += np.diag([1.0, 1.0, 0.0])
    for fix in alike:
        np.testing.assert_allclose(C_e_G @ fix.covariance_e @ C_e_G.T, stated, atol=1e-6)
        assert fix.leader_sigma == 1.0


def test_a_gyro_too_poor_to_navigate_uses_roll_and_pitch() -> None:
    _, top = live.world()
    for name in list(top['parameters']):
        if name.startswith(('gyro', 'accel')):
            del top['parameters'][name]
    top['heading'] = HEADING | {'reference': 'magnetic', 'declination_applied_deg': 3.0}
    for imu, used in (('bmi088', True), ('stim300', False)):
        params = live.params_of(top | {'noise': {'imu': imu}})
        assert params.heading_tilts is used
        assert params.heading_declination_deg == 3.0


def test_an_antenna_beside_a_transponder_widens_its_fixes() -> None:
    """The filter knows one point: the antenna's offset of any direction is covariance."""
    _, top = live.world()
    gnss = GNSS | {'surface_depth': 1.0, 'delay_s': 0.1}
    top['fixes'][0]['transponder_lever_b'] = [0.0, 0.0, -0.5]
    both = mapping_file.parse(yaml.safe_dump(top | {'fixes': [*top['fixes'], gnss]}), 'mapping')
    assert both.params['transponder_lever_b'] == [0.0, 0.0, -0.5]
    assert both.fixes[1].offset_b == (1.0, 0.0, 1.0)
    alone = mapping_file.parse(yaml.safe_dump(top | {'fixes': [gnss]}), 'mapping')
    assert alone.params['transponder_lever_b'] == [1.0, 0.0, 0.5]
    assert not any(alone.fixes[0].offset_b)
    stamps = np.array([1_000_000_000])
    values = {'geodetic': np.array([[80.0, 120.0, 10.0]]), 'status': np.array([0])}
    rows = Rows('/gnss/fix', gnss['type'], stamps, stamps, values, {})
    fix, plain = (
        fixes_of(m.fixes[-1], positions_of(rows, m.fixes[-1].position))[0] for m in (both, alone)
    )
    assert fix.surface_depth == 1.0
    C_e_G = ecef_to_grid(plain.r_e)
    np.testing.assert_allclose(C_e_G @ (fix.r_e - plain.r_e), [0.0, 0.0, -1.0], atol=1e-8)
    widened = C_e_G @ (fix.covariance_e - plain.covariance_e) @ C_e_G.T
    np.testing.assert_allclose(widened, np.diag([0.5, 0.5, 0.02]), atol=1e-8)
