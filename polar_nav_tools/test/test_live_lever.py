"""An IMU in the bow of a running vehicle: live, replayed and by its mapping the same bits."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_worlds import Recorder, aiding_columns, imu_column, rows_of, stamps_of, truth_of
from rclpy.serialization import deserialize_message
from test_live_sources import Rows, Voyage, params_of, sail, world

from polar_nav_core.errors import ConfigError
from polar_nav_msgs.msg import NavState
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.live import Sources
from polar_nav_ros.topics import STATE
from polar_nav_tools.foreign.load import load
from polar_nav_tools.foreign.replay import run
from polar_nav_tools.foreign.sources import open_source
from polar_nav_tools.replay.recorded import load_inputs
from polar_nav_tools.replay.verification import verify

pytestmark = pytest.mark.slow

LEVER_B = [1.2, -0.2, 0.3]


def in_the_bow() -> tuple[Rows, dict[str, Any]]:
    """40 s of the vehicle of `world`, whose IMU is in its bow, and the mapping that states it."""
    truth, make = truth_of(120.0), Recorder()
    stamps = stamps_of(truth, 0.0, 40.0, 0.01)
    columns = [imu_column(make, truth, stamps, lever_b=LEVER_B)]
    columns += aiding_columns(make, truth, 0.0, 40.0)[:-1]
    top = world()[1]
    top['imu']['lever_b'] = LEVER_B
    top['fixes'][0]['delay_s'] = 8.0  # stated, so that all read the same time of reception
    return list(rows_of(make, columns)), top


@pytest.fixture(scope='module')
def sailed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    rows, top = in_the_bow()
    return sail(tmp_path_factory.mktemp('lever') / 'bag', rows, top), top


def states_of(path: Path) -> list[NavState]:
    [life] = load_inputs(path).lives
    return [deserialize_message(data, NavState) for data in life.live[STATE]]


def test_live_equals_replay(sailed: tuple[Path, dict[str, Any]]) -> None:
    result = verify(sailed[0])
    assert result.ok, result.difference
    assert not result.problems
    assert result.counts[STATE][0] > 300


def test_states_are_of_base_link(sailed: tuple[Path, dict[str, Any]]) -> None:
    """Near the truth of base_link until the first fix, good to a metre: 1.25 m would show."""
    states = [s for s in states_of(sailed[0]) if not s.fixes_fused]
    assert len(states) > 250
    stamps = [s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in states]
    truth = truth_of(120.0).state(np.array(stamps))
    off_e = np.array([s.r_e for s in states]) - truth.r_e
    off_v = np.array([s.v_g for s in states]) - truth.v_G
    assert np.linalg.norm(off_e, axis=1).max() < 0.1
    assert np.sqrt(np.mean(np.sum(off_v**2, axis=1))) < 0.01


def test_the_same_bag_by_its_mapping_gives_the_same_bits(
    sailed: tuple[Path, dict[str, Any]],
) -> None:
    path, top = sailed
    parsed = mapping_file.parse(yaml.safe_dump(top), 'mapping')
    loaded = load(open_source(path), parsed)
    assert loaded.params == params_of(top)
    offline = run(loaded).estimates
    live = {s.header.stamp.sec * 10**9 + s.header.stamp.nanosec: s for s in states_of(path)}
    common = [k for k, stamp_ns in enumerate(offline.stamp_ns) if int(stamp_ns) in live]
    assert len(common) > 300
    for k in common:
        there = live[int(offline.stamp_ns[k])]
        np.testing.assert_array_equal(there.r_e, offline.r_e[k])
        np.testing.assert_array_equal(there.v_g, offline.v_G[k])
        covariance = np.reshape(there.velocity_covariance_g, (3, 3))
        np.testing.assert_array_equal(covariance, offline.P_velocity_G[k])


def test_a_follower_that_is_started_again_goes_on_at_base_link(tmp_path: Path) -> None:
    rows, top = in_the_bow()
    begin_ns = rows[0][1]

    def between(begin_s: float, end_s: float) -> Rows:
        return [row for row in rows if begin_s <= 1e-9 * (row[1] - begin_ns) < end_s]

    voyage = Voyage(top, 'follower.state')
    voyage.start(begin_ns)
    voyage.feed(between(0.0, 17.0))
    saved = voyage.session.engine.saved()
    voyage.start(between(17.5, 18.0)[0][1], saved)
    voyage.feed(between(17.5, 33.0))
    path = voyage.write(tmp_path / 'bag', between(0.0, 40.0))
    result = verify(path)
    assert result.ok, result.difference
    assert not result.problems
    first = deserialize_message(load_inputs(path).lives[1].live[STATE][0], NavState)
    assert not first.fixes_fused
    stamp = first.header.stamp
    truth = truth_of(120.0).state(np.array([stamp.sec * 10**9 + stamp.nanosec]))
    assert np.linalg.norm(first.r_e - truth.r_e[0]) < 0.3


def test_a_state_of_now_is_of_base_link() -> None:
    """What a pose on set_pose changes is the state of base_link, height and velocity too."""
    rows, top = in_the_bow()
    voyage = Voyage(top)
    voyage.start(rows[0][1])
    voyage.feed(rows[:3000])
    engine = voyage.session.engine
    state, saved = engine.state(), engine.saved()
    assert state is not None
    assert saved is not None
    assert saved.height - state.height == pytest.approx(LEVER_B[2], abs=0.2)
    assert engine.arm is not None
    there = engine.arm.to_imu(state)
    assert there.height == pytest.approx(saved.height, abs=1e-6)
    assert there.v_G == pytest.approx(saved.v_G, abs=1e-9)
    assert there.latitude == pytest.approx(saved.latitude, abs=1e-13)


@pytest.mark.parametrize(
    ('changes', 'says'),
    [
        ({'model_aiding': True}, 'lever_b does not go with parameter model_aiding'),
        ({'dvl_lever_b': [-99.0, 0.0, 0.0]}, r'dvl_lever_b .* m from it along an axis'),
    ],
)
def test_what_does_not_go_with_it_is_refused_at_the_start(
    changes: dict[str, Any], says: str
) -> None:
    rows, top = in_the_bow()
    voyage = Voyage(top)
    voyage.params = replace(voyage.params, **changes)
    with pytest.raises(ConfigError, match=says):
        voyage.start(rows[0][1])
    assert Sources(mapping_file.parse(voyage.text, 'm'), voyage.params)
