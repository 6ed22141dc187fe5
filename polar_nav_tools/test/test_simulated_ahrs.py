"""The simulated AHRS in a mission's graph, and its messages through a mapping file's adapter."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.live import Sources, Taken
from polar_nav_sim import params as sim
from polar_nav_sim.convert import compass_to_msg, magnetic_to_msg
from polar_nav_sim.mission import load_mission
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.compass import CompassErrors, CompassSensor
from polar_nav_tools.graph.build import build_graph
from polar_nav_tools.graph.options import GraphOptions

MISSION = """
start_time: 2026-03-01T00:00:00Z
duration_s: 60.0
path: {kind: straight, latitude_deg: -80.0, longitude_deg: 240.0, course_deg: 0.0, speed_mps: 2.0}
vehicles:
  leader: {role: leader, depth_m: 20.0, offset_m: [100.0, 0.0]}
  follower:
    role: follower
    depth_m: 30.0
    instruments: {ahrs: {preset: consumer, hard_iron_nt: 200, rate_hz: 5}}
"""
MAPPING = """
version: 2
imu: {topic: /follower/imu/data_raw, type: sensor_msgs/msg/Imu, rotation: flu}
heading:
  {topic: /follower/ahrs/imu, type: sensor_msgs/msg/Imu, rotation: flu, world: enu,
   reference: magnetic, declination_applied_deg: 0.0, bias_sigma_deg: 4.0}
"""


def test_a_mission_gives_a_vehicle_an_ahrs(tmp_path: Path) -> None:
    file = tmp_path / 'mission.yaml'
    file.write_text(MISSION, encoding='utf-8')
    graph = build_graph(load_mission(str(file)), GraphOptions(bag=tmp_path / 'bag'))
    [node] = [n for n in graph.nodes if n.executable == 'ahrs_node']
    assert node.namespace == 'follower'
    p = from_mapping(sim.AhrsParams, node.parameters | {'lockstep': True})
    assert (p.hard_iron_nt, p.drift_deg, p.rate_hz) == (200.0, 2.0, 5.0)
    assert graph.topics['/follower/ahrs/imu'] == 'sensor_msgs/msg/Imu'
    assert graph.topics['/follower/ahrs/mag'] == 'sensor_msgs/msg/MagneticField'
    assert '/leader/ahrs/imu' not in graph.topics
    values = yaml.safe_load(MISSION)
    values['vehicles']['follower']['instruments']['ahrs'] = {'hard_iron': 3.0}
    file.write_text(yaml.safe_dump(values), encoding='utf-8')
    with pytest.raises(ConfigError, match='hard_iron'):
        load_mission(str(file))


def test_its_messages_are_read_as_a_mapping_states_them() -> None:
    """Orientation in east and north of its magnetic north; the field in body axes."""
    pytest.importorskip('pygeomag')
    source = Sources(mapping_file.parse(MAPPING, 'm'), FollowerParams()).of('heading/data')
    assert source is not None
    errors = CompassErrors()
    sensor = CompassSensor(errors, 'magnetic', 0.1, stream(3, 'follower/compass'))
    r_e = np.asarray(ecef_from_geodetic(math.radians(-80.0), math.radians(240.0), -30.0))
    for k in range(20):
        C_b_G = np.asarray(matrix_from_euler(0.3 * k, 0.03, -0.05))
        stamp_ns = 1_790_000_000_000_000_000 + k * 100_000_000
        reading = sensor.measure(k, stamp_ns, r_e, C_b_G, np.array([1.0, 0.5, 0.0]))
        message = compass_to_msg(reading, errors, stamp_ns, 'follower/ahrs')
        source.bind(message, {})
        event = source.event(Taken(message, stamp_ns, stamp_ns), k)
        assert abs(math.remainder(event.heading - reading.heading, math.tau)) < 1e-12
        np.testing.assert_allclose(event.up_b, reading.up_b, atol=1e-12)
        field = magnetic_to_msg(reading, errors, stamp_ns, 'follower/ahrs').magnetic_field
        assert [field.x, field.y, field.z] == pytest.approx(list(reading.field_b * 1e-9))
        assert message.angular_velocity_covariance[0] == -1.0
