"""`polar map` takes lever arms and axes of sensors from /tf_static."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_worlds import (
    DEPTH_LEVER_B,
    DVL_LEVER_B,
    TRANSPONDER_LEVER_B,
    Column,
    Recorder,
    aiding_columns,
    imu_column,
    stamps_of,
    truth_of,
    write_columns,
)
from scipy.spatial.transform import Rotation

from polar_nav_ros.adapters import mapping_file, rotations
from polar_nav_tools.bags.reader import Topic
from polar_nav_tools.foreign.guess import _dvl_axes, guess
from polar_nav_tools.foreign.guess_noise import Choices
from polar_nav_tools.foreign.mounting import Mounts, Transform, mounts_of
from polar_nav_tools.foreign.sources import open_source

KNOWN = Choices(imu='stim300', dvl='workhorse_1200', reference='bottom')
FRD = rotations.named('frd')
LEVEL = np.eye(3)
SOURCE: Any = None
"""Nothing has to be read of it."""
IMU_LEVER_B = (0.1, -0.2, 0.05)


def turned(yaw_deg: float, roll_deg: float = 0.0) -> np.ndarray:
    return Rotation.from_euler('ZYX', [yaw_deg, 0.0, roll_deg], degrees=True).as_matrix()


def static(make: Recorder, stamp_ns: int, *links: tuple[str, str, Any, np.ndarray]) -> Column:
    """One message of /tf_static: parent, child, place and axes of the child."""
    transforms = []
    for parent, child, r, C in links:
        x, y, z, w = (float(v) for v in Rotation.from_matrix(C).as_quat())
        transform = make.make(
            'geometry_msgs/msg/Transform',
            translation=make.make(
                'geometry_msgs/msg/Vector3', x=float(r[0]), y=float(r[1]), z=float(r[2])
            ),
            rotation=make.make('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w),
        )
        transforms.append(
            make.make(
                'geometry_msgs/msg/TransformStamped',
                header=make.header(parent),
                child_frame_id=child,
                transform=transform,
            )
        )
    template = make.make('tf2_msgs/msg/TFMessage', transforms=transforms)
    return Column('/tf_static', 'tf2_msgs/msg/TFMessage', np.array([stamp_ns]), template, {})


def guessed(folder: Path, *links: tuple[str, str, Any, np.ndarray]) -> tuple[str, Any]:
    truth, make = truth_of(40.0), Recorder()
    columns = [imu_column(make, truth, stamps_of(truth, 0.0, 40.0, 0.01))]
    columns += aiding_columns(make, truth, 0.0, 40.0)[:-1]
    if links:
        columns.append(static(make, truth.start_ns, *links))
    text = guess(open_source(write_columns(folder / 'bag', make, columns)), KNOWN)
    return text, yaml.safe_load(text)


VEHICLE = (
    ('auv/base_link', 'imu_frd', IMU_LEVER_B, FRD),
    # Through a frame between, whose axes are turned.
    ('auv/base_link', 'mast', (0.0, 0.0, 1.0), turned(90.0)),
    ('mast', 'pressure', (0.0, -0.2, -0.6), LEVEL),
    # The vehicle may be the child.
    ('dvl_frd', 'auv/base_link', -FRD.T @ np.array(DVL_LEVER_B), FRD.T),
    ('auv/base_link', 'transponder', TRANSPONDER_LEVER_B, LEVEL),
)


def test_levers_and_axes_are_those_of_the_transforms(tmp_path: Path) -> None:
    text, top = guessed(tmp_path, *VEHICLE)
    assert top['imu']['lever_b'] == list(IMU_LEVER_B)
    assert top['imu']['rotation'] == 'frd'
    assert top['dvl']['lever_b'] == list(DVL_LEVER_B)
    assert top['dvl']['rotation'] == 'frd'
    assert top['depth']['lever_b'] == list(DEPTH_LEVER_B)
    assert top['fixes'][0]['transponder_lever_b'] == list(TRANSPONDER_LEVER_B)
    assert 'by /tf_static: pressure in auv/base_link' in text
    assert 'by /tf_static: imu_frd in auv/base_link; gravity agrees, up is -z' in text
    assert 'where it sits from base_link' not in text
    mapping = mapping_file.parse(text.replace('FILL_IN', '0.0'), 'm')
    assert mapping.imu.lever_b == IMU_LEVER_B
    np.testing.assert_allclose(mapping.dvl.C_s_b, FRD, atol=1e-12)


def test_without_transforms_they_are_to_fill_in(tmp_path: Path) -> None:
    text, top = guessed(tmp_path)
    assert text.count('where it sits from base_link') == 3
    assert top['dvl']['lever_b'] == [0.0, 0.0, 0.0]
    assert '/tf_static' not in text


def test_frames_that_lead_to_no_base_link_say_nothing(tmp_path: Path) -> None:
    text, _ = guessed(tmp_path, ('frame', 'imu_frd', (1.0, 0.0, 0.0), FRD))
    assert '/tf_static' not in text


def test_gravity_is_believed_before_a_transform(tmp_path: Path) -> None:
    """A description that draws the IMU as a box, without its turn."""
    text, top = guessed(tmp_path, ('base_link', 'imu_frd', IMU_LEVER_B, LEVEL))
    assert top['imu']['rotation'] == 'frd'
    assert top['imu']['lever_b'] == list(IMU_LEVER_B)
    assert 'it would be flu, which gravity' in text


def test_any_angle_becomes_angles_of_the_mapping() -> None:
    C = turned(30.0, 180.0)
    mount = Mounts([Transform('base_link', 'dvl', np.zeros(3), C)]).of('/dvl')
    assert mount is not None
    value = yaml.safe_load(mount.rotation_text)
    np.testing.assert_allclose(rotations.from_rpy_deg(value['rpy_deg']), C, atol=1e-5)
    assert Mounts().of('dvl') is None


def test_the_last_statement_of_a_frame_counts_and_nonsense_is_left_out(tmp_path: Path) -> None:
    make = Recorder()
    good = static(make, 2, ('base_link', 'dvl', (1.0, 2.0, 3.0), LEVEL))
    old = static(make, 1, ('base_link', 'dvl', (9.0, 9.0, 9.0), LEVEL))
    bad = static(make, 3, ('base_link', 'imu', (np.nan, 0.0, 0.0), LEVEL))
    folders = []
    for k, columns in enumerate(([old, good], [bad])):
        folders.append(write_columns(tmp_path / f'bag{k}', make, columns))
    mount = mounts_of(open_source(folders[0])).of('dvl')
    assert mount is not None
    assert mount.lever_text == '[1.0, 2.0, 3.0]'
    assert mounts_of(open_source(folders[1])).of('imu') is None


def test_a_dvl_that_looks_down_is_not_turned_up_by_a_description() -> None:
    """Its type says where z points; a transform that agrees says where x does."""
    a50 = Topic('/dvl/data', 'dvl_msgs/msg/DVL', 10)
    upright, looking_down = (
        Mounts([Transform('base_link', 'dvl', np.zeros(3), C)]).of('dvl')
        for C in (LEVEL, turned(45.0, 180.0))
    )
    name, why = _dvl_axes(SOURCE, a50, upright)
    assert name == 'frd'
    assert 'FILL IN' in why
    name, why = _dvl_axes(SOURCE, a50, looking_down)
    assert yaml.safe_load(name)['rpy_deg'] == pytest.approx([180.0, 0.0, 45.0], abs=1e-3)
    assert why == 'by /tf_static: dvl in base_link'


@pytest.mark.parametrize('frame', ['base_link', 'auv/base_link'])
def test_messages_of_base_link_itself_have_no_lever(frame: str) -> None:
    mount = Mounts([Transform(frame, 'dvl', np.ones(3), LEVEL)]).of(frame)
    assert mount is not None
    assert mount.lever_text == '[0.0, 0.0, 0.0]'
    assert mount.rotation_text == 'flu'
