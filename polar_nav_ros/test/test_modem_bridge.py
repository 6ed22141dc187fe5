"""The modem bridge in process: packets to and from topics of a driver. Ring 2."""

import os
import time

import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from std_msgs.msg import ByteMultiArray, String, UInt8MultiArray  # noqa: E402

from polar_nav_core.errors import ConfigError  # noqa: E402
from polar_nav_msgs.msg import AcousticPacket  # noqa: E402
from polar_nav_ros.modem_bridge import ModemBridge  # noqa: E402
from polar_nav_ros.qos import BEST_EFFORT, DATA_QOS  # noqa: E402
from polar_nav_ros.stamps import to_msg, to_ns  # noqa: E402

DATA = bytes(range(57))
FILE = """
version: 1
receive: {topic: modem/rx, type: std_msgs/msg/UInt8MultiArray, stamp: log, source: leader}
transmit: {topic: modem/tx, type: std_msgs/msg/ByteMultiArray, values: {layout.data_offset: 3}}
"""


@pytest.fixture(autouse=True)
def _ros(monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    yield
    rclpy.try_shutdown()


class Rig:
    def __init__(self, path, text, sent=ByteMultiArray, take=UInt8MultiArray):
        path.write_text(text, encoding='utf-8')
        args = ['--ros-args', '-r', '__ns:=/auv', '-p', f'modem:={path}']
        rclpy.init(args=args, domain_id=80 + os.getpid() % 19)
        self.bridge = ModemBridge()
        self.peer = rclpy.create_node('driver', use_global_arguments=False)
        self.heard, self.sent = [], []
        listen, offer = self.peer.create_subscription, self.peer.create_publisher
        listen(AcousticPacket, '/auv/acomms/rx', self.heard.append, DATA_QOS)
        listen(sent, '/auv/modem/tx', self.sent.append, DATA_QOS)
        self.tx = offer(AcousticPacket, '/auv/acomms/tx', DATA_QOS)
        self.rx = offer(take, '/auv/modem/rx', BEST_EFFORT)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.bridge)
        self.executor.add_node(self.peer)
        self.until(lambda: self.tx.get_subscription_count() and self.rx.get_subscription_count())
        self.until(lambda: all(n for n in self.bridge_matches()))

    def bridge_matches(self):
        return [output.matched for output in self.bridge._outputs]

    def until(self, done, seconds=20.0):
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        assert done()

    def end(self):
        self.bridge.destroy_node()
        self.peer.destroy_node()


def test_packets_go_both_ways(tmp_path):
    rig = Rig(tmp_path / 'modem.yaml', FILE)
    before = rig.bridge.get_clock().now().nanoseconds
    rig.rx.publish(UInt8MultiArray(data=DATA))
    rig.until(lambda: rig.heard)
    (heard,) = rig.heard
    assert bytes(heard.data) == DATA
    assert (heard.source, heard.destination, heard.sequence) == ('leader', 'auv', 0)
    assert to_ns(heard.receive_time) >= before
    assert to_ns(heard.transmit_time) == 0
    rig.tx.publish(AcousticPacket(data=DATA, transmit_time=to_msg(5)))
    rig.until(lambda: rig.sent)
    assert b''.join(rig.sent[0].data) == DATA
    assert rig.sent[0].layout.data_offset == 3
    assert rig.bridge.diagnose().level == 0
    rig.end()


def test_a_packet_that_is_too_long_is_counted_and_not_sent(tmp_path):
    text = FILE.replace('layout.data_offset: 3}', 'layout.data_offset: 3}, max_payload_bytes: 57')
    rig = Rig(tmp_path / 'modem.yaml', text)
    rig.tx.publish(AcousticPacket(data=DATA + b'more'))
    rig.tx.publish(AcousticPacket(data=DATA))
    rig.until(lambda: rig.sent)
    assert [b''.join(m.data) for m in rig.sent] == [DATA]
    found = rig.bridge.diagnose()
    assert (found.level, found.message) == (1, '1 packets too long to send')
    rig.end()


def test_a_text_carries_packets_in_an_encoding(tmp_path):
    text = FILE.replace('UInt8MultiArray', 'String, fields: {payload: data}, encoding: hex')
    text = text.replace('ByteMultiArray', 'String, fields: {payload: data}, encoding: base64')
    text = text.replace('values: {layout.data_offset: 3}', 'max_payload_bytes: 57')
    rig = Rig(tmp_path / 'modem.yaml', text, sent=String, take=String)
    rig.rx.publish(String(data='no hex'))
    rig.rx.publish(String(data=DATA.hex()))
    rig.until(lambda: rig.heard)
    assert bytes(rig.heard[0].data) == DATA
    assert rig.bridge.counts['received that hold no bytes'] == 1
    rig.end()


@pytest.mark.parametrize(
    ('old', 'new', 'says'),
    [
        ('layout.data_offset', 'layout.offset', "no attribute 'offset'"),
        ('data_offset: 3', 'data_offset: a', 'values: std_msgs/msg/ByteMultiArray'),
        ('layout.data_offset', 'layout.dim', 'layout.dim is no number and no text'),
        ('std_msgs/msg/Byte', 'acme_msgs/msg/Byte', 'needs the package acme_msgs'),
        ('type: std_msgs/msg/ByteMultiArray, ', '', 'type is missing'),
        ('ByteMultiArray', 'String', 'has no adapter for transmit; give `fields` with payload'),
        (
            'std_msgs/msg/ByteMultiArray',
            'std_msgs/msg/String, fields: {payload: data}',
            'a text, which cannot hold any byte',
        ),
    ],
)
def test_what_cannot_be_sent_is_named_at_the_start(tmp_path, old, new, says):
    path = tmp_path / 'modem.yaml'
    path.write_text(FILE.replace(old, new), encoding='utf-8')
    rclpy.init(args=['--ros-args', '-p', f'modem:={path}'], domain_id=80 + os.getpid() % 19)
    with pytest.raises(ConfigError, match=says):
        ModemBridge()


def test_the_file_is_required():
    rclpy.init(args=[], domain_id=80 + os.getpid() % 19)
    with pytest.raises(ConfigError, match='parameter modem is missing'):
        ModemBridge()
