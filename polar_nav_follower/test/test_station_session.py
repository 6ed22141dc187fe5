"""A follower in station mode behind its topics: what it takes, publishes and refuses. Ring 2."""

import logging
import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Imu

from polar_nav_core import earth, grid
from polar_nav_core.engine.events import CommandKind
from polar_nav_core.link import station_packet
from polar_nav_core.link.station_packet import StationReport
from polar_nav_follower import session
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import AcousticPacket, Command, Depth, FixReceipt, NavState
from polar_nav_ros import topics
from polar_nav_ros.diagnostics import Level
from polar_nav_ros.navigation_health import NavigationHealth
from polar_nav_ros.stamps import NS, to_msg, to_ns

START_NS = 1_772_323_200_000_000_000
AWAY_S = np.array([500.0, 200.0, -15.0])
"""Where the vehicle lies, station frame."""
PARAMS = FollowerParams(
    mode='station',
    configuration='default',
    reorder_window_s=0.5,
    station_latitude_deg=89.5,
    station_longitude_deg=60.0,
    station_height=-5.0,
    initial_sigma_position=10.0,
    initial_sigma_velocity=0.1,
    model_net_buoyancy=0.0,
)


def lying_still():
    """Parameters of a vehicle that starts where it lies."""
    origin_e = PARAMS.station_origin_e()
    r_e = origin_e + grid.ecef_to_grid(origin_e).T @ AWAY_S
    lat, lon, height = (float(v) for v in earth.geodetic_from_ecef(r_e))
    return replace(
        PARAMS,
        initial_latitude_deg=math.degrees(lat),
        initial_longitude_deg=math.degrees(lon),
        initial_height=height,
    )


class Boat:
    """A vehicle that lies still in still water, and what its session publishes."""

    def __init__(self, params=None):
        self.params = params or lying_still()
        self.session = session.Session(self.params, 'auv')
        self.stamp_ns = START_NS
        self.published = {}
        self.sent = 0

    def give(self, topic, message):
        for name, out, _ in self.session.take(topic, message):
            self.published.setdefault(name, []).append(out)

    def of(self, topic):
        return self.published.get(topic, [])

    def receipts(self, verdict):
        return [r for r in self.of(topics.RECEIPT) if r.verdict == verdict]

    def imu(self, *, covariance=0.0):
        message = Imu()
        message.header.stamp = to_msg(self.stamp_ns)
        message.linear_acceleration.z = 9.83
        message.orientation_covariance[0] = covariance
        self.give(topics.AHRS, message)

    def rest(self, seconds):
        for k in range(round(100 * seconds)):
            self.stamp_ns += 10_000_000
            if k % 10 == 0:
                thrust = WrenchStamped()
                thrust.header.stamp = to_msg(self.stamp_ns)
                self.give(topics.CONTROL, thrust)
                depth = Depth(depth=-self.params.initial_height, variance=0.0025)
                depth.header.stamp = to_msg(self.stamp_ns)
                self.give(topics.DEPTH, depth)
            self.imu()

    def packet(self, data=None, late_s=1.0):
        report = StationReport(
            source=1,
            target=2,
            sequence=self.sent % 256,
            validity_ns=self.stamp_ns,
            station_position=np.zeros(3),
            station_heading=0.3,
            station_heading_sigma=0.0,
            range=float(np.linalg.norm(AWAY_S)),
            bearing=math.atan2(AWAY_S[1], AWAY_S[0]) - 0.3,
            sound_speed=1500.0,
        )
        message = AcousticPacket(source='station', destination='auv', sequence=self.sent)
        message.data = station_packet.encode(report) if data is None else data
        message.transmit_time = message.header.stamp = to_msg(self.stamp_ns + 600_000_000)
        message.receive_time = to_msg(self.stamp_ns + round(late_s * NS))
        self.sent += 1
        self.give(topics.RX, message)


@pytest.fixture(scope='module')
def boat():
    boat = Boat()
    for _ in range(8):
        boat.rest(2.5)
        boat.packet()
    boat.rest(2.5)
    return boat


def test_it_takes_the_sensors_of_its_mode_only():
    assert session.inputs_of(PARAMS) == (
        'imu/data',
        'control/thrust',
        'depth/data',
        'acomms/rx',
        'nav/command',
    )
    assert session.inputs_of(FollowerParams()) == session.INPUTS


def test_states_come_ten_times_a_second_and_say_nothing_of_sensors_that_are_not_there(boat):
    states = boat.of(topics.STATE)
    assert len(states) == pytest.approx(220, abs=3)
    last = states[-1]
    assert last.status == NavState.STATUS_NAVIGATING
    assert (last.configuration, last.child_frame_id) == ('default', 'auv/base_link')
    for name in ('gyro_bias_b', 'accel_bias_b', 'dvl_scale_m', 'dvl_markov_m', 'usbl_bias_a'):
        assert np.isnan(getattr(last, name)).all(), name
    for name in ('position_covariance_g', 'velocity_covariance_g', 'attitude_covariance_g'):
        assert (np.diagonal(np.reshape(getattr(last, name), (3, 3))) > 0.0).all(), name
    assert last.depth_updates > 0
    origin_e = boat.params.station_origin_e()
    away = grid.ecef_to_grid(origin_e) @ (np.array(last.r_e) - origin_e)
    np.testing.assert_allclose(away, AWAY_S, atol=3.0)
    assert last.fixes_fused == len(boat.receipts(FixReceipt.FUSED)) == 8


def test_current_and_model_come_once_a_second_with_the_first_state_of_it(boat):
    currents, models = boat.of(topics.CURRENT), boat.of(topics.MODEL)
    assert len(currents) == len(models) == pytest.approx(23, abs=1)
    stamps = [to_ns(m.header.stamp) for m in models]
    assert stamps == [to_ns(m.header.stamp) for m in currents]
    seconds = [stamp // NS for stamp in stamps]
    assert seconds == sorted(set(seconds))
    of_states = {to_ns(m.header.stamp) for m in boat.of(topics.STATE)}
    assert set(stamps) <= of_states
    assert 0.0 < currents[-1].covariance_g[0] < boat.params.current_sigma**2
    assert list(currents[-1].velocity_g) == list(models[-1].current_g)
    assert models[-1].drag_linear_sigma > 0.0


def test_what_a_packet_said_is_published_for_people_before_its_receipt(boat):
    decoded = boat.of(topics.STATION_DECODED)
    assert [d.sequence for d in decoded] == list(range(8))
    first = decoded[0]
    assert (first.source, first.target, first.header.frame_id) == ('station', 'auv', 'station')
    assert first.range == pytest.approx(np.linalg.norm(AWAY_S), abs=0.06)
    assert first.range_sigma == pytest.approx(math.sqrt(boat.params.range_variance(first.range)))
    way_s = (to_ns(first.return_time) - to_ns(first.header.stamp)) / NS
    assert way_s == pytest.approx(first.range / 1500.0, abs=1e-6)


def test_a_packet_that_cannot_be_used_gets_a_receipt_that_says_why():
    boat = Boat()
    boat.rest(1.0)
    damaged = bytearray(24)
    damaged[0] = 2
    boat.packet(bytes(damaged))
    boat.packet(b'not a packet')
    boat.rest(3.0)
    (bad,) = boat.receipts(FixReceipt.BAD_CRC)
    (strange,) = boat.receipts(FixReceipt.BAD_FORMAT)
    assert (bad.topic, bad.source) == (strange.topic, strange.source) == ('acomms/rx', 'station')


def test_samples_without_attitude_are_refused_and_the_filter_says_that_it_waits():
    boat = Boat()
    for _ in range(60):
        boat.stamp_ns += 10_000_000
        boat.imu(covariance=-1.0)
    refused = boat.receipts(FixReceipt.NOT_FINITE)
    assert refused
    assert refused[0].topic == 'imu/data'
    assert 'attitude' in refused[0].reason
    assert not boat.of(topics.STATE)
    assert not boat.session.engine.navigating
    diagnosis = NavigationHealth(boat.session.engine, logging.getLogger()).diagnose({})
    assert diagnosis.level is Level.WARN
    assert 'had no attitude' in diagnosis.message


def test_identify_is_answered_and_does_not_forget_the_state():
    other = Boat()
    other.rest(3.0)
    before = len(other.of(topics.STATE))
    command = Command(kind=int(CommandKind.IDENTIFY))
    command.header.stamp = to_msg(other.stamp_ns)
    other.give(topics.COMMAND, command)
    other.rest(3.0)
    assert len(other.of(topics.STATE)) == pytest.approx(before + 30, abs=2)
    (found,) = other.of(topics.IDENTIFICATION)
    assert found.trigger == 'command'
    assert found.verdict_text == 'TOO_FEW_FIXES'
    assert found.reason
