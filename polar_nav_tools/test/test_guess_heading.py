"""`polar map` finds an AHRS by gravity, and asks for what only its owner knows."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters import mapping_file
from polar_nav_tools.experiments.cheap import recording
from polar_nav_tools.foreign.guess import guess
from polar_nav_tools.foreign.guess_noise import Choices
from polar_nav_tools.foreign.sources import open_source

KNOWN = Choices(imu='vn100', dvl='a50_standard', reference='bottom')
FLU_OF_FRD = np.diag([1.0, -1.0, -1.0])
NED_OF_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@lru_cache(maxsize=1)
def readings() -> recording.Readings:
    return recording.readings(3, 12.0)


def guessed(folder: Path, r: recording.Readings) -> str:
    return guess(open_source(recording.write(folder / 'bag', r)), KNOWN)


def with_orientations(R: np.ndarray, **imu: np.ndarray) -> recording.Readings:
    """Readings with other orientations of the AHRS."""
    quaternions = Rotation.from_matrix(R).as_quat()
    r = readings()
    return replace(r, imu=r.imu._replace(quaternion_xyzw=quaternions, **imu))


def test_two_lines_are_left_to_fill_in(tmp_path: Path) -> None:
    """What counts as north, and how good the fixes are; then the file is a follower's."""
    text = guessed(tmp_path, readings())
    top = yaml.safe_load(text)
    assert text.count(': FILL_IN') == 2
    assert top['heading'] == {
        'topic': recording.IMU,
        'type': 'sensor_msgs/msg/Imu',
        'rotation': 'flu',
        'world': 'enu',
        'reference': 'FILL_IN',
    }
    assert top['dvl']['rotation'] == 'frd'
    assert 'initial' not in top
    with pytest.raises(ConfigError, match=r'sigma: is still to be filled in: \[horizontal'):
        mapping_file.parse(text, 'm')
    text = text.replace('sigma: FILL_IN', 'sigma: 2.5')
    with pytest.raises(ConfigError, match='reference: is still to be filled in: true, magnetic'):
        mapping_file.parse(text, 'm')
    mapping = mapping_file.parse(text.replace('reference: FILL_IN', 'reference: true'), 'm')
    assert mapping.params['heading_reference'] == 'true'
    assert mapping.fixes[0].sigma == (2.5, 2.5)


def test_axes_of_an_ahrs_that_looks_down(tmp_path: Path) -> None:
    r = readings()
    R = NED_OF_ENU @ Rotation.from_quat(r.imu.quaternion_xyzw).as_matrix() @ FLU_OF_FRD
    frd = {n: getattr(r.imu, n) @ FLU_OF_FRD for n in ('rate_b', 'force_b')}
    top = yaml.safe_load(guessed(tmp_path, with_orientations(R, **frd)))
    assert (top['heading']['rotation'], top['heading']['world']) == ('frd', 'ned')


@pytest.mark.parametrize('turn_deg', [0.0, 20.0])
def test_an_orientation_that_is_no_attitude_is_left_out(tmp_path: Path, turn_deg: float) -> None:
    """One that never changes, and one that gravity contradicts."""
    r = readings()
    R = Rotation.from_quat(r.imu.quaternion_xyzw).as_matrix()
    R = R @ Rotation.from_euler('X', turn_deg, degrees=True).as_matrix()
    if not turn_deg:
        R = np.broadcast_to(np.eye(3), R.shape)
    top = yaml.safe_load(guessed(tmp_path, with_orientations(R)))
    assert 'heading' not in top
    assert top['initial']['heading_deg'] == 'FILL_IN'
