"""The small bags that come with the sources: each opens, is whole, and replays as promised."""

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message

from polar_nav_core.engine.health.radius import radius_95
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_msgs.msg import NavHealth, NavState
from polar_nav_ros.stamps import to_ns
from polar_nav_tools.bags import open_bag
from polar_nav_tools.bags.arrays import estimates_from_cdr, load_receipts, receipts_from_cdr
from polar_nav_tools.live.run_info import cpu_model, versions
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.comparison import compare
from polar_nav_tools.replay.recorded import load_inputs

BAGS = Path(__file__).parents[1] / 'bags'
REFERENCES = sorted(p.parent.name for p in BAGS.glob('reference*/metadata.yaml'))
LISTED = re.compile(r'^\| `(\w+)` \| (\d+) \|', re.MULTILINE)


@pytest.fixture(scope='module', params=REFERENCES)
def run(request):
    """The inputs of a reference bag, and its replay by messages."""
    inputs = load_inputs(open_bag(BAGS / request.param))
    return inputs, replay(inputs)


def test_reference_bag_replays_to_what_was_recorded(run):
    """To a millionth of sigma with the same verdicts: another processor may round otherwise."""
    inputs, replayed = run
    assert inputs.bag.problems == []
    assert len(inputs.live['nav/state']) > 100
    comparison = compare(inputs, replayed)
    assert comparison.ok, comparison.problems()
    recorded = load_receipts(inputs.bag, inputs.vehicle)
    assert 'FUSED' in {r.verdict_text for r in recorded}
    again = receipts_from_cdr(replayed.of('nav/receipt'))
    assert [r.verdict_text for r in recorded] == [r.verdict_text for r in again]


def test_position_and_covariance_are_the_recorded_ones(run):
    inputs, replayed = run
    # By the definition in the bag, which may be of an earlier version.
    live = [message for _, message in inputs.bag.read(f'/{inputs.vehicle}/nav/state')]
    series = estimates_from_cdr(replayed.of('nav/state'), inputs.vehicle)
    assert len(live) == len(series.stamp_ns)
    for i, a in enumerate(live):
        recorded_P = np.reshape(a.position_covariance_g, (3, 3))
        sigma = np.sqrt(np.diagonal(recorded_P))
        assert np.linalg.norm(a.r_e - series.r_e[i]) < 1e-6 * sigma.min()
        np.testing.assert_allclose(series.P_position_G[i], recorded_P, rtol=1e-6)


def test_a_bag_of_this_engine_replays_bit_for_bit_where_it_was_recorded(run):
    inputs, replayed = run
    where = (inputs.bag.run_info['cpu'], inputs.bag.run_info['versions'])
    if inputs.engine_version != ENGINE_VERSION or where != (cpu_model(), versions()):
        pytest.skip('recorded by another engine, processor or library')
    assert all(inputs.live[topic] == replayed.of(topic) for topic in inputs.live)


def test_the_page_lists_every_kept_bag_with_its_engine():
    kept = {p.parent.name: p.parent for p in BAGS.glob('*/metadata.yaml')}
    kept = {name: path for name, path in kept.items() if name in (*REFERENCES, 'station')}
    listed = dict(LISTED.findall((BAGS / 'README.md').read_text()))
    recorded_by = {
        name: str(load_inputs(open_bag(path)).engine_version) for name, path in kept.items()
    }
    assert listed == recorded_by


def test_health_is_published_each_second_with_the_radius_of_the_state(run):
    _, result = run
    found = [deserialize_message(data, NavHealth) for data in result.of('nav/health')]
    states = {
        to_ns(s.header.stamp): s
        for s in (deserialize_message(data, NavState) for data in result.of('nav/state'))
    }
    assert [m.header.stamp.sec for m in found] == sorted({t // 10**9 for t in states})
    for m in found:
        P = np.reshape(states[to_ns(m.header.stamp)].position_covariance_g, (3, 3))
        assert m.r95_horizontal_m == radius_95(P[:2, :2])
        assert (m.level, m.status) == (NavHealth.OK, NavHealth.STATUS_NAVIGATING)
    last = found[-1]
    assert (last.imu_age_s, last.reset_counter) == (0.0, 0)
    assert 0.0 <= last.dvl_age_s <= 1.2  # pings come at 5 Hz; the health is up to a second old
    assert 0.0 <= last.depth_age_s <= 1.2
    assert 0.0 < last.fix_age_s < 5.0
