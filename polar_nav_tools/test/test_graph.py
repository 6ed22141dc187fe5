"""The one definition of the graph: names, parameters, what the follower is told at its start."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml

from polar_nav_core import attitude, earth, grid
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import NodeParams, from_mapping, to_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_leader.params import LeaderParams
from polar_nav_sim import params as sim_params
from polar_nav_sim.initial_state import InitialSigma, initial_parameters
from polar_nav_sim.mission import load_mission
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors import presets
from polar_nav_tools.graph.build import build_graph
from polar_nav_tools.graph.options import GraphOptions
from polar_nav_tools.graph.processes import composed, separate
from polar_nav_tools.graph.recorded_topics import recorded_topics
from polar_nav_tools.graph.spec import NodeSpec, Stage, parameter_yaml
from polar_nav_tools.live.run import read_mission
from polar_nav_tools.record.params import RecorderParams

PARAMETERS = {
    'truth_node': sim_params.TruthParams,
    'imu_node': sim_params.ImuParams,
    'dvl_node': sim_params.DvlParams,
    'depth_node': sim_params.DepthParams,
    'usbl_node': sim_params.UsblParams,
    'leader_reference_node': sim_params.LeaderReferenceParams,
    'acoustic_link_node': sim_params.AcousticLinkParams,
    'leader_node': LeaderParams,
    'follower_node': FollowerParams,
    'recorder_node': RecorderParams,
}
CONFIG = Path(__file__).resolve().parents[1] / 'config'
EXPECTED = {
    '/truth_node',
    '/acoustic_link_node',
    '/recorder_node',
    *(f'/{v}/{s}_node' for v in ('leader', 'follower') for s in ('imu', 'dvl', 'depth')),
    '/leader/usbl_node',
    '/leader/leader_reference_node',
    '/leader/leader_node',
    '/follower/follower_node',
}


@pytest.fixture(scope='module')
def mission():
    return load_mission('demo').with_duration(20.0)


@pytest.fixture(scope='module')
def graph(mission):
    return build_graph(mission, GraphOptions(seed=7, bag=Path('bags/x')))


def node(graph, full_name) -> NodeSpec:
    return next(n for n in graph.nodes if n.full_name == full_name)


def params_of(spec: NodeSpec) -> NodeParams:
    return from_mapping(PARAMETERS[spec.executable], dict(spec.parameters))


def test_all_nodes_are_there_once(graph):
    names = [n.full_name for n in graph.nodes]
    assert sorted(names) == sorted(EXPECTED)


def test_every_node_accepts_its_parameters(graph):
    for spec in graph.nodes:
        params_of(spec)


def test_the_truth_waits_for_all_others(graph):
    truth = node(graph, '/truth_node')
    assert set(truth.parameters['expected_nodes']) == EXPECTED - {'/truth_node'}
    assert all(params_of(n).lockstep for n in graph.nodes if n is not truth)


def test_in_real_time_truth_waits_for_the_graph_and_then_for_nobody(mission):
    graph = build_graph(mission, GraphOptions(pace='realtime'))
    assert not any(params_of(n).lockstep for n in graph.nodes)
    truth = node(graph, '/truth_node')
    assert all(params_of(n).presence for n in graph.nodes if n is not truth)
    assert set(params_of(truth).expected_nodes) == {
        n.full_name for n in graph.nodes if n is not truth
    }
    assert params_of(truth).pace == 'realtime'
    assert params_of(node(graph, '/follower/follower_node')).reorder_window_s >= 1.0
    assert '/recorder_node' not in {n.full_name for n in graph.nodes}


@pytest.mark.parametrize('pace', ['realtime', 'lockstep'])
def test_a_graph_to_be_looked_at_waits_for_a_shorter_time(mission, pace):
    options = GraphOptions(pace=pace, reorder_s=0.25)
    follower = node(build_graph(mission, options), '/follower/follower_node')
    assert follower.parameters['reorder_window_s'] == (0.25 if pace == 'realtime' else 2.0)


def test_the_reorder_window_is_at_least_twice_the_window_of_the_truth(graph):
    window_s = params_of(node(graph, '/truth_node')).window_s
    assert params_of(node(graph, '/follower/follower_node')).reorder_window_s >= 2.0 * window_s


def test_leader_and_follower_agree_on_their_numbers(graph):
    leader = params_of(node(graph, '/leader/leader_node'))
    follower = params_of(node(graph, '/follower/follower_node'))
    assert (leader.own_id, leader.follower_id) == (follower.leader_id, follower.own_id)
    assert leader.own_id != leader.follower_id


def test_seed_reaches_every_node_that_draws(graph):
    drawing = [n for n in graph.nodes if hasattr(params_of(n), 'seed')]
    assert len(drawing) == 9
    assert {params_of(n).seed for n in drawing} == {7}


def test_each_stage_feeds_the_next(graph):
    stages = {n.executable: n.stage for n in graph.nodes}
    assert stages['truth_node'] < stages['usbl_node'] < stages['leader_node']
    assert stages['leader_node'] < stages['acoustic_link_node'] < stages['follower_node']
    assert stages['recorder_node'] == max(Stage)


# -- a leader that navigates by itself


@pytest.fixture(scope='module')
def own(mission):
    return build_graph(mission, GraphOptions(seed=7, leader='own', bag=Path('bags/x')))


def test_nobody_plays_the_navigation_of_a_leader_that_has_its_own(own):
    names = [n.full_name for n in own.nodes]
    assert sorted(names) == sorted(EXPECTED - {'/leader/leader_reference_node'})
    assert set(node(own, '/truth_node').parameters['expected_nodes']) == set(names) - {
        '/truth_node'
    }
    assert all(params_of(n).lockstep for n in own.nodes if n.executable != 'truth_node')


def test_by_default_the_leader_is_told(graph):
    assert params_of(node(graph, '/leader/leader_node')).navigation == 'odometry'
    assert graph.options.leader == 'perfect'


def test_its_instruments_are_better_and_the_followers_are_not_touched(graph, own):
    imu, dvl = (params_of(node(own, f'/leader/{name}_node')) for name in ('imu', 'dvl'))
    for params, preset in ((imu, presets.IMU['leader']), (dvl, presets.DVL['leader'])):
        for name, value in to_mapping(preset.errors).items():
            assert to_mapping(params)[name] == value
    for name in ('imu', 'dvl', 'depth'):
        path = f'/follower/{name}_node'
        assert node(own, path).parameters == node(graph, path).parameters


def test_it_starts_off_truth_by_its_own_sigmas_and_its_own_draw(mission, own):
    leader = params_of(node(own, '/leader/leader_node'))
    assert leader.navigation == 'own'
    first = mission.truth('leader').state(mission.start_ns + mission.imu_period_ns)
    told = node(own, '/leader/leader_node').parameters
    dr_G, dv_G, phi_G = errors_of(told, first)
    unit = stream(7, 'leader/initial_state').standard_normal((3, 3))
    np.testing.assert_allclose(dr_G, unit[0] * [1.0, 1.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(dv_G, unit[1] * 0.01, atol=1e-12)
    np.testing.assert_allclose(phi_G, unit[2] * np.radians([0.005, 0.005, 0.06]), atol=1e-12)
    assert leader.initial_sigma_position == 1.0


def test_the_follower_waits_for_the_leader_to_have_waited(graph, own):
    window_s = params_of(node(own, '/truth_node')).window_s
    leader = params_of(node(own, '/leader/leader_node')).reorder_window_s
    assert leader >= 2.0 * window_s
    assert params_of(node(own, '/follower/follower_node')).reorder_window_s >= (
        leader + 2.0 * window_s
    )
    assert params_of(node(graph, '/follower/follower_node')).reorder_window_s == 2.0 * window_s


def test_its_own_topics_are_recorded(graph, own):
    navigation = ('state', 'receipt', 'health', 'clock', 'command', 'fix')
    more = {'absolute/fix', *(f'nav/{topic}' for topic in navigation)}
    assert set(own.topics) - set(graph.topics) == {f'/leader/{topic}' for topic in more}
    assert set(graph.topics) <= set(own.topics)


def test_in_real_time_the_leader_knows_in_time_where_it_was(mission):
    graph = build_graph(mission, GraphOptions(pace='realtime', leader='own'))
    leader = params_of(node(graph, '/leader/leader_node'))
    assert leader.reorder_window_s + leader.output_period_s <= leader.processing_delay_s


def test_vehicle_names_come_from_the_mission(mission, tmp_path):
    document = yaml.safe_load(mission.file.read_text())
    document['vehicles'] = {
        'mother': document['vehicles']['leader'],
        'pup': document['vehicles']['follower'],
    }
    file = tmp_path / 'renamed.yaml'
    file.write_text(yaml.safe_dump(document))
    graph = build_graph(load_mission(file), GraphOptions(bag=tmp_path / 'b'))
    assert '/pup/follower_node' in {n.full_name for n in graph.nodes}
    assert params_of(node(graph, '/mother/leader_node')).follower == 'pup'
    assert params_of(node(graph, '/mother/usbl_node')).targets == ('pup',)
    assert params_of(node(graph, '/acoustic_link_node')).vehicles == ('mother', 'pup')
    assert '/pup/nav/state' in graph.topics


def test_two_followers_are_refused_by_name(mission, tmp_path):
    document = yaml.safe_load(mission.file.read_text())
    document['vehicles']['second'] = document['vehicles']['follower']
    file = tmp_path / 'two.yaml'
    file.write_text(yaml.safe_dump(document))
    with pytest.raises(ConfigError, match='one follower is needed, it has follower, second'):
        build_graph(load_mission(file), GraphOptions())


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'pace': 'fast'}, "pace 'fast' is none of lockstep, realtime"),
        ({'configuration': 'best'}, "configuration 'best' is none of"),
        ({'leader': 'best'}, "leader 'best' is none of perfect, own"),
        ({'seed': -1}, 'seed -1 is outside of'),
        ({'seed': 2**31}, 'seed 2147483648 is outside of'),
    ],
)
def test_options_are_checked(options, message):
    with pytest.raises(ConfigError, match=message):
        GraphOptions(**options)


def test_parameter_file_keeps_types(graph):
    spec = node(graph, '/follower/follower_node')
    read = yaml.safe_load(parameter_yaml(spec))
    assert read == {'/follower/follower_node': {'ros__parameters': dict(spec.parameters)}}
    kinds = {f.name: f.metadata['kind'] for f in dataclasses.fields(FollowerParams)}
    for name, value in read['/follower/follower_node']['ros__parameters'].items():
        if kinds[name] == 'float':
            assert isinstance(value, float), name


def test_separate_nodes_have_a_process_each(graph):
    processes = separate(graph.nodes)
    assert [process.name for process in processes] == [n.full_name for n in graph.nodes]
    assert [process.module for process in processes] == [n.module for n in graph.nodes]


def test_nodes_of_a_vehicle_can_share_a_process_and_those_of_the_root_do_not(graph):
    found = {process.name: process for process in composed(graph.nodes)}
    assert set(found) == {
        '/truth_node',
        '/acoustic_link_node',
        '/recorder_node',
        '/leader (imu_node, dvl_node, depth_node, leader_reference_node, usbl_node, leader_node)',
        '/follower (imu_node, dvl_node, depth_node, follower_node)',
    }
    assert sorted(n.full_name for p in found.values() for n in p.nodes) == sorted(EXPECTED)
    # It is ended with the last of its nodes, and they are closed from upstream to downstream.
    assert (
        found['/follower (imu_node, dvl_node, depth_node, follower_node)'].stage is Stage.FOLLOWER
    )
    assert list(found)[-1] == '/recorder_node'
    for process in found.values():
        assert [n.stage for n in process.nodes] == sorted(n.stage for n in process.nodes)


def test_nodes_that_are_started_again_keep_processes_of_their_own(mission, tmp_path):
    options = GraphOptions(pace='realtime', respawn=True, bag=tmp_path / 'bag')
    processes = composed(build_graph(mission, options).nodes)
    assert [p.name for p in processes if p.respawns] == [
        '/leader/leader_node',
        '/acoustic_link_node',
        '/follower/follower_node',
        '/recorder_node',
    ]
    assert '/follower (imu_node, dvl_node, depth_node)' in [p.name for p in processes]


def test_recorded_topics_have_full_names_and_types():
    for topic, kind in recorded_topics('leader', 'follower').items():
        assert topic.startswith('/')
        assert kind.count('/') == 2
        assert kind.split('/')[1] == 'msg'


@pytest.mark.parametrize('file', sorted(CONFIG.glob('*.yaml')), ids=lambda f: f.name)
def test_example_files_are_accepted_by_the_nodes_they_name(file):
    for name, section in yaml.safe_load(file.read_text()).items():
        from_mapping(PARAMETERS[name.rpartition('/')[2]], section['ros__parameters'])


# -- the initial state

SIGMA = InitialSigma(position=5.0, height=3.0, velocity=0.01, tilt_deg=0.01, heading_deg=0.1)


def errors_of(values, state):
    """Estimate minus truth in the filter's signs: (dr_G, dv_G, phi_G)."""
    r_e = earth.ecef_from_geodetic(
        np.radians(values['initial_latitude_deg']),
        np.radians(values['initial_longitude_deg']),
        values['initial_height'],
    )
    psi = 0.5 * np.pi - np.radians(values['initial_grid_heading_deg'])
    C = attitude.matrix_from_euler(
        psi, np.radians(values['initial_pitch_deg']), np.radians(values['initial_roll_deg'])
    )
    dr_G = grid.ecef_to_grid(state.r_e) @ (r_e - state.r_e)
    phi_G = -attitude.log(C @ state.C_b_G.T)
    return dr_G, np.array(values['initial_v_G']) - state.v_G, phi_G


@pytest.mark.parametrize('name', ['demo', 'near_pole', 'over_pole', 'south_pole'])
def test_initial_errors_are_those_drawn(name):
    state = load_mission(name).truth('follower')
    state = state.state(state.start_ns)
    dr_G, dv_G, phi_G = errors_of(
        initial_parameters(state, SIGMA, np.random.default_rng(3)), state
    )
    unit = np.random.default_rng(3).standard_normal((3, 3))
    # Degrees of longitude in a float are good to nanometres, cos(latitude) does not matter.
    np.testing.assert_allclose(dr_G, unit[0] * [5.0, 5.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(dv_G, unit[1] * 0.01, atol=1e-12)
    np.testing.assert_allclose(phi_G, unit[2] * np.radians([0.01, 0.01, 0.1]), atol=1e-12)


def test_without_sigma_the_truth_itself_is_told(mission):
    state = mission.truth('follower').state(mission.start_ns)
    none = InitialSigma(0.0, 0.0, 0.0, 0.0, 0.0)
    values = initial_parameters(state, none, np.random.default_rng(1))
    for error in errors_of(values, state):
        np.testing.assert_allclose(error, 0.0, atol=1e-8)


def test_the_draw_belongs_to_seed_and_vehicle(mission):
    def told(seed):
        graph = build_graph(mission, GraphOptions(seed=seed))
        return node(graph, '/follower/follower_node').parameters

    assert told(1) == told(1)
    assert told(1)['initial_height'] != told(2)['initial_height']


def test_the_state_holds_at_the_first_imu_sample(mission):
    values = node(build_graph(mission, GraphOptions()), '/follower/follower_node').parameters
    first = mission.truth('follower').state(mission.start_ns + mission.imu_period_ns)
    dr_G, dv_G, phi_G = errors_of(values, first)
    defaults = FollowerParams()
    assert np.abs(dv_G).max() < 5.0 * defaults.initial_sigma_velocity
    assert np.abs(dr_G).max() < 5.0 * defaults.initial_sigma_position
    assert np.abs(phi_G[:2]).max() < 5.0 * np.radians(defaults.initial_sigma_tilt_deg)


def test_a_track_as_recorded_reaches_the_truth_node():
    usual = build_graph(read_mission('near_pole', 20.0), GraphOptions())
    drifting = build_graph(read_mission('near_pole', 20.0, as_recorded=True), GraphOptions())
    assert 'overrides' not in usual.nodes[0].parameters
    assert drifting.nodes[0].parameters['overrides'] == ['path.as_recorded=true']


def test_only_a_track_can_be_sailed_as_recorded():
    with pytest.raises(ConfigError, match='as_recorded'):
        read_mission('demo', None, as_recorded=True)
