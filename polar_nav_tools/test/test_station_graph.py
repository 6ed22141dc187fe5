"""The graph of a mission with a station: who runs, what they are told, what is recorded."""

from pathlib import Path

import numpy as np
import pytest

from polar_nav_core import earth
from polar_nav_core.engine.configurations import STATION_VARIANTS, compared_of, parameters_of
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping
from polar_nav_sim.mission import load_mission
from polar_nav_tools.development.pages import NODES
from polar_nav_tools.graph.build import build_graph
from polar_nav_tools.graph.options import GraphOptions
from polar_nav_tools.graph.spec import NodeSpec, Stage
from polar_nav_tools.replay.by_message import parameters


@pytest.fixture(scope='module')
def mission():
    return load_mission('station').with_duration(20.0)


@pytest.fixture(scope='module')
def graph(mission):
    options = GraphOptions(seed=7, bag=Path('bags/x'))
    return build_graph(mission, options)


def node(graph, full_name) -> NodeSpec:
    return next(n for n in graph.nodes if n.full_name == full_name)


def params_of(spec: NodeSpec):
    return from_mapping(NODES[spec.executable], dict(spec.parameters))


def test_a_station_takes_the_place_of_the_leader_and_nobody_has_a_dvl(graph):
    assert {n.full_name for n in graph.nodes} == {
        '/vehicle_node',
        '/auv/imu_node',
        '/auv/depth_node',
        '/station/station_node',
        '/acoustic_link_node',
        '/auv/follower_node',
        '/recorder_node',
    }
    stages = [n.stage for n in graph.nodes]
    assert stages == sorted(stages)


def test_every_node_accepts_its_parameters_and_the_seed_reaches_those_that_draw(graph):
    for spec in graph.nodes:
        params = params_of(spec)
        assert getattr(params, 'seed', 7) == 7
        if spec.stage is not Stage.TRUTH:
            assert params.lockstep
    truth = params_of(node(graph, '/vehicle_node'))
    assert list(truth.expected_nodes) == [n.full_name for n in graph.nodes[1:]]


def test_station_and_follower_agree_on_who_they_are_and_where_the_axes_begin(graph, mission):
    station = params_of(node(graph, '/station/station_node'))
    follower = params_of(node(graph, '/auv/follower_node'))
    assert (station.own_id, station.target_id) == (follower.leader_id, follower.own_id)
    assert station.target == 'auv'
    assert follower.mode == 'station'
    assert params_of(node(graph, '/auv/imu_node')).ahrs
    first_e = mission.truth('station').state(mission.start_ns).r_e
    np.testing.assert_allclose(follower.station_origin_e(), first_e, atol=1e-6)


def test_the_vehicle_is_told_its_speed_through_the_water(graph, mission):
    follower = params_of(node(graph, '/auv/follower_node'))
    truth = mission.truth('auv').state(mission.start_ns + mission.imu_period_ns)
    assert np.linalg.norm(truth.current_G[:2]) > 0.4
    error = np.array(follower.initial_v_G) - (truth.v_G - truth.current_G)
    assert np.abs(error).max() < 4.0 * follower.initial_sigma_velocity
    place_e = earth.ecef_from_geodetic(
        *np.radians([follower.initial_latitude_deg, follower.initial_longitude_deg]),
        follower.initial_height,
    )
    assert 0.0 < np.linalg.norm(place_e - truth.r_e) < 5.0 * follower.initial_sigma_position


def test_what_is_needed_for_a_replay_and_for_its_truth_is_recorded(graph):
    for topic in (
        '/auv/imu/data',
        '/auv/control/thrust',
        '/auv/depth/data',
        '/auv/acomms/rx',
        '/auv/nav/command',
        '/auv/nav/model',
        '/auv/nav/current',
        '/auv/nav/identification',
        '/auv/truth/model',
        '/auv/truth',
        '/station/truth',
        '/station/station/fix',
        '/station/acomms/tx',
    ):
        assert topic in graph.topics
    assert not any('dvl' in topic for topic in graph.topics)


def test_a_station_does_not_navigate_by_itself(mission):
    with pytest.raises(ConfigError, match='station is a station, which knows where it is'):
        build_graph(mission, GraphOptions(configuration='default', leader='own'))


def test_filters_of_the_other_mode_are_refused_with_those_of_this_one(mission):
    with pytest.raises(ConfigError, match="'modified_akf' is for a leader; with a station there"):
        build_graph(mission, GraphOptions(configuration='modified_akf'))
    with pytest.raises(ConfigError, match="'published' is for a station; without one there are"):
        build_graph(load_mission('demo'), GraphOptions(configuration='published'))


def test_a_vehicle_without_dynamics_cannot_do_with_ranges_and_bearings(mission):
    formation = dict(mission.document['vehicles'])
    formation['auv'] = {k: v for k, v in formation['auv'].items() if k != 'dynamics'}
    with pytest.raises(ConfigError, match='auv has no dynamics'):
        build_graph(
            mission.with_overrides({'vehicles': formation}), GraphOptions(configuration='default')
        )


@pytest.mark.parametrize('name', STATION_VARIANTS)
def test_every_name_of_a_filter_stands_for_parameters_that_the_follower_takes(graph, name):
    recorded = dict(node(graph, '/auv/follower_node').parameters)
    params = parameters(recorded, name, {})
    assert params.mode == 'station'
    assert params.station_filter == ('published' if name == 'published' else 'augmented')
    assert params.identify_method == ('published' if name == 'published' else 'robust')
    strategy = params.resolved().delay_handling
    assert strategy == name or name in ('default', 'published')


def test_names_mean_configurations_where_there_is_no_station():
    assert parameters_of('default', {}) == {'configuration': 'default'}
    assert compared_of({}) == ('conventional_akf', 'modified_akf', 'default')
    assert compared_of({'mode': 'station'}) == ('published', 'default')
