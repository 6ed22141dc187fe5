"""What a mission says of instruments, clocks and water reaches the nodes."""

from pathlib import Path

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping
from polar_nav_ros.adapters import mapping_file
from polar_nav_sim import params as sim
from polar_nav_sim.mission import load_mission
from polar_nav_sim.sensors.instruments import DVL, IMU
from polar_nav_tools.graph.build import GraphOptions, build_graph

PROFILE = 'arctic_ssp/sizrs_2016_october6_drop6.csv'
SAYS = {
    'sound_speed_profile': PROFILE,
    'vehicles.leader.clock_offset_s': 0.05,
    'vehicles.leader.instruments': {'heading': 'octans', 'usbl': 'ship'},
    'vehicles.follower.instruments': {'imu': 'stim300', 'dvl': 'a50_standard', 'depth': 'strain'},
}


def parameters(name='demo', changes=SAYS, **options):
    mission = load_mission(name).with_duration(20.0).with_overrides(changes)
    graph = build_graph(mission, GraphOptions(seed=7, **options))
    return {spec.full_name: spec.parameters for spec in graph.nodes}


def test_instruments_reach_their_nodes():
    got = parameters()
    imu = from_mapping(sim.ImuParams, got['/follower/imu_node'])
    dvl = from_mapping(sim.DvlParams, got['/follower/dvl_node'])
    assert imu.gyro_g_sigma_dph == IMU['stim300'].errors.gyro_g_sigma_dph
    assert (dvl.assumed_sound_speed, dvl.rate_hz) == (1500.0, DVL['a50_standard'].rate_hz)
    assert imu.seed == dvl.seed == 7
    assert from_mapping(sim.DepthParams, got['/follower/depth_node']).drift_sigma_m == 0.3
    assert from_mapping(sim.UsblParams, got['/leader/usbl_node']).range_sigma_m == 0.1
    reference = from_mapping(sim.LeaderReferenceParams, got['/leader/leader_reference_node'])
    assert 0.5 < reference.heading_sigma_deg < 0.6


def test_a_clock_belongs_to_all_of_a_vehicle():
    got = parameters()
    for node in ('imu_node', 'dvl_node', 'depth_node', 'usbl_node', 'leader_reference_node'):
        assert got[f'/leader/{node}']['clock_offset_s'] == 0.05
    assert 'clock_offset_s' not in got['/follower/imu_node']


def test_all_who_hear_are_in_the_same_water():
    got = parameters()
    for node in ('/leader/usbl_node', '/follower/dvl_node', '/acoustic_link_node'):
        assert got[node]['sound_speed_profile'].endswith(PROFILE)
    station = parameters('station', {'sound_speed': 1460.0}, configuration='default')
    assert station['/station/station_node']['sound_speed'] == 1460.0
    assert station['/acoustic_link_node']['sound_speed'] == 1460.0


def test_a_mission_that_says_nothing_changes_nothing():
    got = parameters(changes={})
    assert got['/follower/dvl_node'] == {'seed': 7, 'lockstep': True}
    assert got['/follower/imu_node'] == {'seed': 7, 'lockstep': True}


def test_a_vehicle_alone_has_its_own_sensors_and_is_told_its_mapping_file_only():
    mission = load_mission('ahrs')
    graph = build_graph(mission, GraphOptions(bag=Path('bags/x')))
    sensors = {'imu', 'dvl', 'depth', 'ahrs', 'absolute_fix', 'follower'}
    assert {spec.full_name for spec in graph.nodes} == {
        '/truth_node', '/recorder_node', *(f'/auv/{name}_node' for name in sensors)
    }  # fmt: skip
    got = {spec.full_name: spec.parameters for spec in graph.nodes}
    assert set(got['/auv/follower_node']) == {
        'configuration', 'sea_surface_height', 'sources', 'reorder_window_s', 'lockstep'
    }  # fmt: skip
    ugps = from_mapping(sim.AbsoluteFixParams, got['/auv/absolute_fix_node'])
    assert (ugps.period_s, ugps.horizontal_sigma_m) == (2.0, 1.5)
    # All that the file names is published, of the type that it states.
    mapping = mapping_file.load(mission.sources('auv'))
    heard = [mapping.imu, mapping.dvl, mapping.depth, mapping.heading]
    streams = [m.stream for m in heard] + [f.position.stream for f in mapping.fixes]
    assert len(streams) == 5
    for stream in streams:
        assert graph.topics[f'/auv/{stream.topic}'] == stream.type
    assert graph.topics['/auv/nav/inputs'] == 'polar_nav_msgs/msg/Inputs'
    assert not [topic for topic in graph.topics if 'acomms' in topic or 'usbl' in topic]


def test_nobody_navigates_by_itself_where_nobody_leads():
    with pytest.raises(ConfigError, match='mission ahrs has no leader that could navigate'):
        build_graph(load_mission('ahrs'), GraphOptions(leader='own'))
    with pytest.raises(ConfigError, match="'published' is for a station"):
        build_graph(load_mission('ahrs'), GraphOptions(configuration='published'))


def test_a_follower_of_a_leader_may_have_a_mapping_file_too():
    file = load_mission('ahrs').sources('auv')
    got = parameters(changes={'vehicles.follower.sources': str(file)})
    assert got['/follower/follower_node']['sources'] == str(file)
    assert '/leader/leader_node' in got
    assert 'initial_latitude_deg' not in got['/follower/follower_node']


def test_a_leader_that_navigates_has_no_heading_to_play():
    with pytest.raises(ConfigError, match='heading instrument'):
        parameters(leader='own')
