"""What a bag says of vehicle and water: estimated, identified, true."""

import json

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import serialize_message
from std_msgs.msg import String

from polar_nav_core.engine.outputs import ModelEstimate
from polar_nav_core.identification.result import Identification, IdentificationVerdict
from polar_nav_ros.model_outputs import identification_to_msg, model_to_msg
from polar_nav_tools.bags import BagError, BagWriter, open_bag
from polar_nav_tools.bags.model import load_model_run, load_true_model, model_run_from_cdr

START_NS = 1_600_000_000_000_000_000
FOUND = np.diag([4.0, 1.0, 1e-4])
TYPES = {
    '/auv/nav/model': 'polar_nav_msgs/msg/VehicleModel',
    '/auv/nav/identification': 'polar_nav_msgs/msg/Identification',
    '/auv/truth/model': 'polar_nav_msgs/msg/VehicleModel',
}


def model(k, **changes):
    values = {
        'v_r_b': np.array([1.0, 0.1, 0.0]),
        'v_r_covariance_b': np.eye(3),
        'current_G': np.array([0.4, 0.2, np.nan]),
        'current_covariance_G': 1e-4 * np.eye(3),
        'drag_linear': 20.0 + k,
        'drag_linear_sigma': 2.0,
        'drag_quadratic': 18.0,
        'drag_quadratic_sigma': 1.5,
        'drag_correlation': -0.9,
        'heading_bias': 0.01,
        'heading_bias_sigma': 0.005,
        'current_walk': 1e-6,
    }
    return serialize_message(
        model_to_msg(ModelEstimate(**{**values, **changes}), START_NS + k * 10**9)
    )


def identification(covariance):
    names = ('drag_linear', 'drag_quadratic', 'current_x')
    return serialize_message(
        identification_to_msg(
            Identification(
                stamp_ns=START_NS + 10**9,
                method='robust',
                verdict=IdentificationVerdict.ACCEPTED,
                reason='well',
                trigger='count',
                fixes=100,
                first_validity_ns=START_NS,
                last_validity_ns=START_NS + 10**9,
                names=names,
                values=np.array([25.0, 19.0, 0.4]),
                covariance=covariance,
                condition_number=100.0,
                cost=90.0,
                iterations=7,
            )
        )
    )


@pytest.fixture
def bag(tmp_path):
    def make(*, topics=TYPES, info=True, found=FOUND):
        path = tmp_path / f'bag{len(list(tmp_path.iterdir()))}'
        with BagWriter(path, {}) as writer:
            for topic, kind in topics.items():
                writer.add_topic(topic, kind)
            if info:
                writer.add_topic('/run_info', 'std_msgs/msg/String')
                described = {
                    'node': '/auv/imu_node',
                    'package': 'polar_nav_sim',
                    'params': {'ahrs_heading_bias_deg': 2.0},
                }
                text = serialize_message(String(data=json.dumps(described)))
                writer.write('/run_info', text, START_NS)
            for k in range(3):
                if '/auv/nav/model' in topics:
                    writer.write('/auv/nav/model', model(k), START_NS + k * 10**9)
                if '/auv/truth/model' in topics:
                    writer.write('/auv/truth/model', model(k), START_NS + k * 10**9)
            if '/auv/nav/identification' in topics and found is not None:
                writer.write('/auv/nav/identification', identification(found), START_NS + 10**9)
        return open_bag(path)

    return make


def test_every_number_comes_back_with_its_stamp(bag):
    run = load_model_run(bag(), 'auv')
    np.testing.assert_array_equal(run.estimated.stamp_ns, START_NS + np.arange(3) * 10**9)
    np.testing.assert_array_equal(run.estimated.drag_linear, [20.0, 21.0, 22.0])
    np.testing.assert_array_equal(run.estimated.current_G[:, :2], [[0.4, 0.2]] * 3)
    np.testing.assert_array_equal(run.estimated.P_current_G[1], 1e-4 * np.eye(3))
    (found,) = run.identified
    assert (found.verdict, found.trigger, found.fixes) == ('ACCEPTED', 'count', 100)
    assert found.values == {'drag_linear': 25.0, 'drag_quadratic': 19.0, 'current_x': 0.4}
    assert found.sigmas['drag_linear'] == 2.0


def test_the_true_bias_of_the_heading_is_that_of_the_ahrs_as_its_node_says(bag):
    np.testing.assert_allclose(load_true_model(bag(), 'auv').heading_bias, np.radians(2.0))


def test_without_the_node_s_word_the_message_s_own_is_taken(bag):
    np.testing.assert_array_equal(load_true_model(bag(info=False), 'auv').heading_bias, 0.01)


def test_a_covariance_of_another_size_gives_no_sigma_and_no_error(bag):
    (found,) = load_model_run(bag(found=np.zeros((0, 0))), 'auv').identified
    assert np.isnan(list(found.sigmas.values())).all()


def test_a_topic_without_messages_is_as_none(bag):
    run = load_model_run(bag(found=None), 'auv')
    assert run.identified == ()
    assert load_model_run(bag(), 'nobody') is None


def test_another_type_on_the_topic_is_named(bag):
    topics = {**TYPES, '/auv/nav/model': 'polar_nav_msgs/msg/Depth'}
    with pytest.raises(BagError, match='/auv/nav/model is a polar_nav_msgs/msg/Depth'):
        load_model_run(bag(topics=topics), 'auv')


def test_a_replay_without_a_model_has_none():
    assert model_run_from_cdr([], [], None) is None
    run = model_run_from_cdr([model(0)], [identification(np.eye(3))], None)
    assert len(run.estimated) == len(run.identified) == 1
