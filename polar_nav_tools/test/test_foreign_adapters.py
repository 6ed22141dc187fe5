"""Adapters of the standard types against this project's own messages of the same quantities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_samples import REFERENCE
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters.mapping import (
    DepthMapping,
    DvlMapping,
    Frame,
    PositionMapping,
    Stream,
)
from polar_nav_tools.foreign.definitions import BUNDLED
from polar_nav_tools.foreign.read import read_depth, read_dvl, read_positions
from polar_nav_tools.foreign.sources import Source, open_source

SIGMA = 0.01


def dvl(topic: str, sigma: float | None = None, **stream: Any) -> DvlMapping:
    """Straight DVL in m/s."""
    return DvlMapping(Stream(topic, **stream), np.eye(3), 1.0, sigma)


def depth(topic: str, unit: str | None = None) -> DepthMapping:
    """Depth, positive down."""
    return DepthMapping(Stream(topic), unit, 1.0, None, 101325.0, None)


def positions(topic: str, kind: str | None = None) -> PositionMapping:
    """Positions in the frame that their type implies, or in a stated one."""
    return PositionMapping(Stream(topic), Frame(kind), np.eye(3))


@pytest.fixture(scope='module')
def reference() -> Source:
    """The reference bag through the foreign door."""
    return open_source(REFERENCE)


def test_twist_is_the_dvl(reference: Source) -> None:
    """TwistWithCovarianceStamped beside Dvl, where the DVL has bottom lock."""
    own = read_dvl(reference, dvl('/follower/dvl/data'), SIGMA, 0.0)
    twist = read_dvl(reference, dvl('/follower/dvl/twist'), SIGMA, 0.0)
    both = own.valid & twist.valid
    assert both.sum() > 140
    assert np.array_equal(own.velocity[both], twist.velocity[both])
    assert np.allclose(own.covariance[both], twist.covariance[both], rtol=1e-12, atol=0.0)


def test_pressure_is_depth(reference: Source) -> None:
    """FluidPressure through TEOS-10 beside Depth; the latitude is that of the start."""
    own = read_depth(reference, depth('/follower/depth/data'), 0.05, 80.0)
    pressure = read_depth(reference, depth('/follower/depth/pressure'), 0.05, 80.0)
    assert np.abs(own.depth - pressure.depth).max() < 1e-3
    assert np.allclose(own.variance, pressure.variance, rtol=0.05)


def test_odometry_navsatfix_and_state_are_one_place(reference: Source) -> None:
    """Three types of the same estimates, of which NavSatFix has no attitude."""
    state = read_positions(reference, positions('/follower/nav/state'))
    odometry = read_positions(reference, positions('/follower/odometry'))
    sat = read_positions(reference, positions('/follower/nav/fix'))
    assert np.abs(state.r_e - odometry.r_e).max() < 1e-8
    assert np.abs(state.C_b_G - odometry.C_b_G).max() < 1e-12
    assert np.abs(state.v_G - odometry.v_G).max() < 1e-12
    at = np.searchsorted(state.stamps_ns, sat.stamps_ns)
    assert np.array_equal(state.stamps_ns[at], sat.stamps_ns)
    assert np.abs(state.r_e[at] - sat.r_e).max() < 1e-6
    assert np.isnan(sat.C_b_G).all()
    known = np.isfinite(sat.covariance_e).all(axis=(1, 2))
    assert known.all()
    assert np.allclose(sat.covariance_e, state.covariance_e[at], rtol=1e-6, atol=1e-9)


def one_topic(path: Path, kind: str, messages: Sequence[Any], store: Any) -> Source:
    """Write messages of one type to topic /t, a second apart."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        link = writer.add_connection('/t', kind, typestore=store)
        for k, message in enumerate(messages):
            writer.write(link, (k + 1) * 10**9, store.serialize_cdr(message, kind))
    return open_source(path)


def jazzy(**texts: str) -> Any:
    """Types of ROS, and others by text (``package__Name``)."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in texts.items():
        store.register(get_types_from_msg(text, name.replace('__', '/msg/')))
    return store


def header(store: Any, stamp_s: int) -> Any:
    """Header at a second."""
    stamp = store.types['builtin_interfaces/msg/Time'](sec=stamp_s, nanosec=0)
    return store.types['std_msgs/msg/Header'](stamp=stamp, frame_id='')


def test_a_position_that_nobody_filled_in_is_none(tmp_path: Path) -> None:
    """0 N 0 E to the last digit is an empty message, whatever its status says."""
    store = jazzy()
    kind = 'sensor_msgs/msg/NavSatFix'
    status = store.types['sensor_msgs/msg/NavSatStatus'](status=0, service=1)

    def fix(latitude: float, longitude: float) -> Any:
        return store.types[kind](
            header=header(store, 1),
            status=status,
            latitude=latitude,
            longitude=longitude,
            altitude=0.0,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )

    source = one_topic(
        tmp_path / 'b', kind, [fix(0.0, 0.0), fix(0.0, 10.0), fix(-1e-9, 0.0)], store
    )
    assert read_positions(source, positions('/t')).given.tolist() == [False, True, True]


def test_dvl_msgs(tmp_path: Path) -> None:
    """Validity is a flag, and the figure of merit is the sigma."""
    body, _, beams = BUNDLED['dvl_msgs/msg/DVL'].partition('=' * 80)
    beam = beams.partition('MSG: dvl_msgs/DVLBeam\n')[2].partition('=' * 80)[0]
    store = jazzy(dvl_msgs__DVLBeam=beam, dvl_msgs__DVL=body)
    vector = store.types['geometry_msgs/msg/Vector3']
    made = [
        store.types['dvl_msgs/msg/DVL'](
            header=header(store, k + 5),
            time=0.0,
            velocity=vector(x=1.0 + k, y=2.0, z=3.0),
            fom=0.02,
            altitude=9.0,
            beams=[],
            velocity_valid=k != 1,
            status=0,
            form='json_v3',
        )
        for k in range(3)
    ]
    source = one_topic(tmp_path / 'b', 'dvl_msgs/msg/DVL', made, store)
    rows = read_dvl(source, dvl('/t'), SIGMA, 0.0)
    assert rows.valid.tolist() == [True, False, True]
    assert np.allclose(rows.covariance, 4e-4 * np.eye(3), rtol=1e-12)
    assert rows.velocity[2].tolist() == [3.0, 2.0, 3.0]
    # The type does not state the sound speed that the instrument assumed: the mapping does.
    assumed = replace(dvl('/t'), sound_speed=1500.0)
    corrected = read_dvl(source, assumed, SIGMA, 1440.0)
    np.testing.assert_allclose(corrected.velocity, 0.96 * rows.velocity, rtol=1e-14)
    np.testing.assert_allclose(corrected.covariance, 0.96**2 * rows.covariance, rtol=1e-14)
    unknown = read_dvl(source, assumed, SIGMA, 0.0)
    np.testing.assert_array_equal(unknown.velocity, rows.velocity)


def test_the_sound_speed_of_a_message_goes_before_that_of_the_mapping(reference: Source) -> None:
    """The simulation states that of its water, 1440 m/s."""
    mapping = replace(dvl('/follower/dvl/data'), sound_speed=1500.0)
    own, corrected = (read_dvl(reference, mapping, SIGMA, c) for c in (0.0, 1404.0))
    good = own.valid
    np.testing.assert_allclose(corrected.velocity[good], 0.975 * own.velocity[good], rtol=1e-14)


def test_a_twist_without_covariance_takes_the_parameter(tmp_path: Path) -> None:
    """TwistStamped states none; `sigma` of the mapping wins over the parameter."""
    store = jazzy()
    t = store.types
    zero = t['geometry_msgs/msg/Vector3'](x=0.5, y=0.0, z=0.0)
    kind = 'geometry_msgs/msg/TwistStamped'
    twist = t['geometry_msgs/msg/Twist'](linear=zero, angular=zero)
    source = one_topic(tmp_path / 'b', kind, [t[kind](header(store, 5), twist)] * 2, store)
    rows = read_dvl(source, dvl('/t'), SIGMA, 0.0)
    assert not rows.stated.any()
    assert np.allclose(rows.covariance, SIGMA**2 * np.eye(3))
    assert np.allclose(read_dvl(source, dvl('/t', 0.3), SIGMA, 0.0).covariance, 0.09 * np.eye(3))


def test_times_and_fields_of_other_types(tmp_path: Path) -> None:
    """A type without a header: log time, or a field of seconds; errors list the fields there."""
    store = jazzy(acme__Depth='float64 seconds\nfloat32 metres\nstring note\n')
    kind = 'acme/msg/Depth'
    made = [store.types[kind](seconds=7.25 + k, metres=float(k), note='') for k in range(3)]
    source = one_topic(tmp_path / 'b', kind, made, store)

    def read(**stream: Any) -> Any:
        mapping = DepthMapping(Stream('/t', **stream), 'm', 1.0, None, 101325.0, None)
        return read_depth(source, mapping, 0.1, 80.0)

    by_log = read(stamp='log', fields={'depth': 'metres'})
    assert by_log.stamps_ns.tolist() == [1 * 10**9, 2 * 10**9, 3 * 10**9]
    by_field = read(fields={'depth': 'metres', 'stamp': 'seconds'}, offset_ns=-(10**9))
    assert by_field.stamps_ns.tolist() == [6250 * 10**6, 7250 * 10**6, 8250 * 10**6]
    assert by_field.depth.tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(ConfigError, match=r'acme/msg/Depth has no adapter for depth.*seconds'):
        read()
    with pytest.raises(ConfigError, match=r'has no header: give `stamp: log`'):
        read(fields={'depth': 'metres'})
    with pytest.raises(ConfigError, match=r'has no field feet; it has seconds, metres'):
        read(fields={'depth': 'feet'})
    with pytest.raises(ConfigError, match=r'unknown quantity deepness; for depth there are'):
        read(fields={'deepness': 'metres'})


def test_a_frame_that_nobody_states(reference: Source) -> None:
    """Positions of a type that carries no frame are not guessed."""
    with pytest.raises(ConfigError, match='frame is missing: geodetic, earth, enu or ned'):
        read_positions(
            reference,
            PositionMapping(
                Stream('/follower/dvl/data', fields={'position': ['velocity.x'] * 3}),
                Frame(None),
                np.eye(3),
            ),
        )
