"""`polar identify` on a bag of the station scenario: figures, truth, verdicts, what is missing."""

import json
import sys

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from polar_nav_core.attitude import quaternion_from_matrix
from polar_nav_core.link.station_packet import StationReport, encode
from polar_nav_msgs.msg import AcousticPacket, Depth, VehicleModel
from polar_nav_ros.stamps import to_msg
from polar_nav_sim.offline_station import StationScenario, simulate
from polar_nav_tools.bags import BagWriter
from polar_nav_tools.cli import main

TYPES = {
    'imu/data': 'sensor_msgs/msg/Imu',
    'control/thrust': 'geometry_msgs/msg/WrenchStamped',
    'depth/data': 'polar_nav_msgs/msg/Depth',
    'acomms/rx': 'polar_nav_msgs/msg/AcousticPacket',
    'truth/model': 'polar_nav_msgs/msg/VehicleModel',
}
TRUTH = {'drag_linear': 25.0, 'drag_quadratic': 19.0, 'current_x': 0.4, 'current_y': 0.25}


def messages(run):
    """(topic, log time, stamp, message), one IMU message in ten."""
    stamps = run.start_ns + np.rint(run.t_s * 1e9).astype(np.int64)
    quaternions = quaternion_from_matrix(run.C_b_G[::10])
    for i, k in enumerate(range(0, len(stamps), 10)):
        stamp_ns = int(stamps[k])
        imu = Imu()
        imu.header.stamp = to_msg(stamp_ns)
        q, w = imu.orientation, imu.angular_velocity
        q.x, q.y, q.z, q.w = quaternions[i].tolist()
        w.x, w.y, w.z = run.omega_ib_b[k].tolist()
        yield 'imu/data', stamp_ns, stamp_ns, imu
        thrust = WrenchStamped()
        thrust.header.stamp = to_msg(stamp_ns)
        thrust.wrench.force.x = float(run.force_b[k, 0])
        yield 'control/thrust', stamp_ns, stamp_ns, thrust
        if i % 10 == 0:
            depth = Depth(depth=float(run.depth[k]), variance=0.0008)
            depth.header.stamp = to_msg(stamp_ns)
            yield 'depth/data', stamp_ns, stamp_ns, depth
            model = VehicleModel(drag_linear=25.0, drag_quadratic=19.0)
            model.header.stamp = to_msg(stamp_ns)
            model.current_g = run.current[k]
            yield 'truth/model', stamp_ns, stamp_ns, model
    f = run.fixes
    for k in range(len(f.sequence)):
        transmit, receive, validity = (
            run.start_ns + round(float(s[k]) * 1e9)
            for s in (f.transmit_s, f.receive_s, f.validity_s)
        )
        report = StationReport(
            1,
            2,
            int(f.sequence[k]),
            validity,
            f.station_position[k],
            float(f.station_heading[k]),
            float(f.station_heading_sigma[k]),
            float(f.range[k]),
            float(f.bearing[k]),
            float(f.sound_speed[k]),
        )
        packet = AcousticPacket(
            source='station', destination='follower', sequence=int(f.sequence[k]), bit_rate=9600.0
        )
        packet.transmit_time = packet.header.stamp = to_msg(transmit)
        packet.receive_time = to_msg(receive)
        packet.data = list(encode(report))
        yield 'acomms/rx', receive, transmit, packet


def write(directory, run, *, without=(), vehicles=('follower',), params=None, change=None):
    params = {'station_height': -run.station_depth} if params is None else params
    with BagWriter(directory, {'seed': 1}) as writer:
        writer.add_topic('/run_info', 'std_msgs/msg/String')
        rows = sorted(messages(run), key=lambda row: row[1])
        for vehicle in vehicles:
            said = {'node': f'/{vehicle}/follower_node', 'package': 'polar_nav_follower'}
            said |= {'version': '0.1.0', 'params': params}
            data = serialize_message(String(data=json.dumps(said)))
            writer.write('/run_info', data, run.start_ns, run.start_ns)
            for topic in TYPES.keys() - set(without):
                writer.add_topic(f'/{vehicle}/{topic}', TYPES[topic])
            for topic, log_ns, stamp_ns, message in rows:
                if topic in without:
                    continue
                if change is not None:
                    change(topic, message)
                data = serialize_message(message)
                writer.write(f'/{vehicle}/{topic}', data, log_ns, stamp_ns)
    return directory


@pytest.fixture(scope='module')
def whole():
    return simulate(StationScenario(duration_s=770.0), 1)


@pytest.fixture(scope='module')
def bag(tmp_path_factory, whole):
    return write(tmp_path_factory.mktemp('bags') / 'station', whole)


@pytest.fixture(scope='module')
def short():
    return simulate(StationScenario(duration_s=60.0), 1)


@pytest.fixture
def polar(monkeypatch, capsys):
    monkeypatch.setenv('COLUMNS', '160')

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


@pytest.mark.slow
def test_figures_of_both_methods_beside_the_truth(polar, bag):
    status, out, _ = polar('identify', bag, '--method', 'both', '--json')
    assert status == 0
    said = json.loads(out)
    assert said['accepted']
    robust, published = said['identifications']
    assert (robust['method'], published['method']) == ('robust', 'published')
    assert robust['packets'] == robust['readable'] >= robust['fixes'] == 300
    for name, true in TRUTH.items():
        assert robust['truth'][name] == pytest.approx(true, abs=1e-6)
        assert abs(robust['values'][name] - true) < 4.0 * robust['sigmas'][name]
    assert robust['sigmas']['current_x'] < 0.01
    assert not robust['notes']
    assert set(published['values']) == set(TRUTH)


@pytest.mark.slow
def test_table_for_people(polar, bag):
    status, out, _ = polar('identify', bag, '--check')
    assert status == 0
    assert out.startswith('ACCEPTED: 300 fixes in 7')
    for word in ('drag_quadratic', 'N s²/m²', 'heading_bias', 'truth', 'error / sigma'):
        assert word in out
    assert '300 of 30' in out


@pytest.mark.slow
def test_earlier_it_was_not_excited_and_check_says_so(polar, bag):
    status, out, _ = polar('identify', bag, '--until', 200)
    assert status == 0
    assert out.startswith('NOT_EXCITED: ')
    assert polar('identify', bag, '--until', 200, '--check')[0] == 1
    status, out, _ = polar('identify', bag, '--until', 60, '--json')
    assert status == 0
    found = json.loads(out)['identifications'][0]
    assert found['verdict'] == 'TOO_FEW_FIXES'
    assert found['values']['drag_linear'] is None
    status, out, _ = polar('identify', bag, '--until', 60)
    assert 'TOO_FEW_FIXES' in out
    assert '24 of 24 fixes in 24 packets' in out
    assert 'nan' not in out


@pytest.mark.slow
def test_a_smaller_window_is_the_newest_part(polar, bag):
    _, out, _ = polar('identify', bag, '--window', 120, '--json')
    found = json.loads(out)['identifications'][0]
    assert found['fixes'] == 120
    _, out, _ = polar('identify', bag, '--json')
    assert found['last_validity_ns'] == json.loads(out)['identifications'][0]['last_validity_ns']


def test_without_the_stations_height_it_says_what_it_assumed(polar, tmp_path, short):
    bag = write(tmp_path / 'b', short, params={}, without=('truth/model',))
    status, out, _ = polar('identify', bag, '--json')
    assert status == 0
    found = json.loads(out)['identifications'][0]
    assert 'treated as horizontal' in found['notes'][0]
    assert found['truth'] == {}


@pytest.mark.parametrize('topic', ['control/thrust', 'depth/data', 'acomms/rx'])
def test_a_topic_that_is_missing_is_named(polar, tmp_path, short, topic):
    bag = write(tmp_path / 'b', short, without=(topic,))
    status, out, err = polar('identify', bag)
    assert (status, out) == (1, '')
    assert f'no message on /follower/{topic}' in err
    assert err.count('\n') == 1


def test_a_bag_without_an_ahrs(polar, tmp_path, short):
    bag = write(tmp_path / 'b', short, without=('imu/data',))
    status, _, err = polar('identify', bag)
    assert status == 1
    assert '<vehicle>/imu/data' in err


def test_an_ahrs_without_attitude(polar, tmp_path, short):
    def no_attitude(topic, message):
        if topic == 'imu/data':
            message.orientation_covariance[0] = -1.0

    status, _, err = polar('identify', write(tmp_path / 'b', short, change=no_attitude))
    assert status == 1
    assert '/follower/imu/data has an orientation' in err


def test_attitudes_are_read_as_the_live_follower_reads_them(polar, tmp_path, short):
    def longer(topic, message):
        if topic == 'imu/data':
            q = message.orientation
            q.x, q.y, q.z, q.w = (1.1 * v for v in (q.x, q.y, q.z, q.w))

    status, _, err = polar('identify', write(tmp_path / 'b', short, change=longer))
    assert status == 1
    assert '/follower/imu/data has an orientation' in err


def test_packets_of_something_else(polar, tmp_path, short):
    def damaged(topic, message):
        if topic == 'acomms/rx':
            message.data = [1, 2, 3]

    status, _, err = polar('identify', write(tmp_path / 'b', short, change=damaged))
    assert status == 1
    assert 'packets on /follower/acomms/rx holds a fix' in err


def test_several_vehicles_need_a_name(polar, tmp_path, short):
    bag = write(tmp_path / 'b', short, vehicles=('one', 'two'))
    status, _, err = polar('identify', bag)
    assert status == 2
    assert 'several vehicles (one, two)' in err
    status, out, _ = polar('identify', bag, '--vehicle', 'two', '--json')
    assert status == 0
    assert json.loads(out)['identifications'][0]['vehicle'] == 'two'
    status, _, err = polar('identify', bag, '--vehicle', 'three')
    assert status == 1
    assert '/three/imu/data' in err
