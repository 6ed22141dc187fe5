"""What a mission says of instruments, clocks and water reaches the nodes."""

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping
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


def test_a_leader_that_navigates_has_no_heading_to_play():
    with pytest.raises(ConfigError, match='heading instrument'):
        parameters(leader='own')
