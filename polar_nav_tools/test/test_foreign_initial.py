"""Mapping files, axes, frames and initial states."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from polar_nav_core import attitude, grid
from polar_nav_core.earth import ecef_from_geodetic, geodetic_from_ecef
from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters import mapping_file, rotations
from polar_nav_ros.adapters.frames import to_earth
from polar_nav_ros.adapters.mapping import Frame
from polar_nav_ros.adapters.section import Section
from polar_nav_ros.adapters.sensors import DvlRows, ImuRows
from polar_nav_tools.bags.finding import Severity
from polar_nav_tools.foreign.initial import Start, find_start

S = 1_000_000_000
LAT, LON = 75.0, 30.0


def read(text: str) -> mapping_file.Mapping:
    """Mapping of a YAML text."""
    return mapping_file.from_section(Section('m.yaml', yaml.safe_load(text)))


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        ('dvl: {topic: /d}', r'm\.yaml: imu: is missing'),
        ('imu: {topc: /i}', r'm\.yaml: imu: topic: is missing'),
        ('imu: {topic: /i, colour: red}', r'm\.yaml: imu: unknown key colour; known here: '),
        ('imu: {topic: /i, time_offset_s: 0,5}', r'imu: unknown key 5 \(numbers have a decimal p'),
        ('imu: {topic: /i}\nparameters: {initial_height: 0,5}', 'parameters: 5 is no name .num'),
        ('imu: {topic: /i}\nfixes: {topic: /f, sigma: 0}', r'sigma: 0 is not .*, above zero \[m'),
        ('imu: {topic: /i, rotation: fru}', r'm\.yaml: imu: rotation: .*right-handed'),
        ('imu: {topic: /i, rotation: xyz}', r'm\.yaml: imu: rotation: .*names no axes'),
        ('imu: {topic: /i, gyro_unit: rpm}', r"m\.yaml: imu: gyro_unit: 'rpm' is none of rad/s"),
        ('imu: {topic: /i, time_offset_s: soon}', r"time_offset_s: 'soon' is not a number \[s\]"),
        ('imu: {topic: /i, rotation: {quaternion: [0, 0, 0, 0]}}', r'rotation: .*zero length'),
        ('imu: {topic: /i}\ndvl: {topic: /d, lever_b: [1, 2]}', r'm\.yaml: dvl: lever_b: '),
        ('imu: {topic: /i}\nfixes: {topic: /f, frame: ned}', r'fixes\[0\]: origin: frame ned'),
        ('imu: {topic: /i}\nfixes: {topic: /f, frame: epsg}', r'fixes\[0\]: epsg: '),
        ('imu: {topic: /i}\nfixes: {topic: /f, sigma: -1}', r'fixes\[0\]: sigma: -1 is not'),
        (
            'imu: {topic: /i}\nfixes: [{topic: /f, transponder_lever_b: [1, 0, 0]}, {topic: /g}]',
            r'm\.yaml: fixes: transponder_lever_b is not the same in all of them',
        ),
        ('imu: {topic: FILL_IN}', r'm\.yaml: imu: topic: is still to be filled in'),
        ('imu: {topic: /i, lever_b: [1, 2, 300]}', r'imu: lever_b\[2\]: 300 is outside of'),
        ('imu: {topic: /i}\ninitial: {from: hope}', r"initial: from: 'hope' is none of"),
        ('imu: {topic: /i}\nparameters: {gyro: 1}', r'parameters: unknown parameter gyro'),
        ('imu: {topic: /i}\naccept: stuck', r"accept: 'stuck' is not a list"),
        ('[]', r'm\.yaml: expected keys with values'),
    ],
)
def test_errors_name_file_key_and_value(text: str, sentence: str) -> None:
    """A mapping is written by hand: its errors must lead to the line."""
    with pytest.raises(ConfigError, match=sentence):
        read(text)


def test_a_file_that_is_no_yaml(tmp_path: Path) -> None:
    """Neither a missing nor a broken file gives a traceback."""
    with pytest.raises(ConfigError, match=r'none\.yaml: No such file'):
        mapping_file.load(tmp_path / 'none.yaml')
    path = tmp_path / 'm.yaml'
    path.write_text('imu: {')
    with pytest.raises(ConfigError, match='not YAML'):
        mapping_file.load(path)


def test_axes_by_name_by_angles_and_by_quaternion_agree() -> None:
    """Forward-right-down is half a turn about x."""
    frd = rotations.named('frd')
    assert np.array_equal(frd, np.diag([1.0, -1.0, -1.0]))
    assert np.allclose(rotations.from_rpy_deg([180.0, 0.0, 0.0]), frd, atol=1e-15)
    assert np.allclose(rotations.from_quaternion([1.0, 0.0, 0.0, 0.0]), frd, atol=1e-15)
    # x points right: what the sensor measures along x comes from the left, negative.
    assert np.array_equal(rotations.named('rfu') @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0])
    assert len(rotations.all_named()) == 24


def test_frames_of_positions() -> None:
    """A point north of and below an origin, in each frame; a map against its own formula."""
    origin = (89.9, 45.0, 10.0)
    lat, lon = np.radians(origin[:2])
    r_0 = np.asarray(ecef_from_geodetic(lat, lon, origin[2]))
    enu = to_earth(Frame('enu', origin), np.array([[0.0, 100.0, -20.0]])).r_e[0]
    ned = to_earth(Frame('ned', origin), np.array([[100.0, 0.0, 20.0]])).r_e[0]
    assert np.abs(enu - ned).max() < 1e-9
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    assert (enu - r_0) @ up == pytest.approx(-20.0)
    assert math.degrees(float(geodetic_from_ecef(enu)[0])) > origin[0]
    # EPSG:3413: polar stereographic, true scale at 70 N; its origin is the pole.
    pole = to_earth(Frame('epsg', epsg=3413), np.array([[0.0, 0.0, 5.0]]))
    assert np.abs(pole.r_e[0] - np.asarray(ecef_from_geodetic(np.pi / 2, 0.0, 5.0))).max() < 1e-6
    scale = np.linalg.norm(pole.axes_e[0], axis=0)
    assert scale[0] == pytest.approx(1.0 / 0.9698582, rel=1e-4)
    with pytest.raises(ConfigError, match='the frame is not stated'):
        to_earth(Frame(None), np.zeros((1, 3)))


def resting(
    roll_deg: float, pitch_deg: float, grid_heading_deg: float, *, bias: float = 0.0
) -> ImuRows:
    """A vehicle at rest at LAT, LON: gravity and the rate of the earth, and a little noise."""
    lat, lon = math.radians(LAT), math.radians(LON)
    psi = math.radians(90.0 - grid_heading_deg)
    C_b_G = attitude.matrix_from_euler(psi, math.radians(pitch_deg), math.radians(roll_deg))
    omega = C_b_G.T @ grid.earth_rate(ecef_from_geodetic(lat, lon, 0.0)) + bias
    f = C_b_G.T @ np.array([0.0, 0.0, 9.83])
    n = 6000
    rng = np.random.default_rng(1)
    stamps = np.arange(n, dtype=np.int64) * 10_000_000 + S
    return ImuRows(
        '/imu',
        stamps,
        stamps,
        omega + rng.normal(0.0, 1e-7, (n, 3)),
        f + rng.normal(0.0, 1e-3, (n, 3)),
    )


def start(
    text: str,
    imu: ImuRows,
    dvl: DvlRows | None = None,
    dvl_from_imu_b: Sequence[float] = (0, 0, 0),
) -> Start:
    """Find the initial state by a mapping's `initial` and `parameters`."""
    mapping = read('imu: {topic: /imu}\n' + text)
    where = np.array(dvl_from_imu_b, dtype=float)
    return find_start(
        mapping.initial, 'm.yaml', mapping.params, imu, dvl, None, dvl_from_imu_b=where
    )


PLACE = f'parameters: {{initial_latitude_deg: {LAT}, initial_longitude_deg: {LON}'


def test_alignment_on_the_data() -> None:
    """Level from gravity, heading as stated; it starts when rest ends."""
    found = start(
        f'initial: {{from: alignment, rest_s: 30, heading_deg: 100.0}}\n{PLACE}}}',
        resting(2.0, -3.0, 40.0),
    )
    assert found.findings == ()
    assert found.stamp_ns == 31 * S
    assert found.values['initial_roll_deg'] == pytest.approx(2.0, abs=0.01)
    assert found.values['initial_pitch_deg'] == pytest.approx(-3.0, abs=0.01)
    true = found.values['initial_grid_heading_deg'] + math.degrees(
        float(grid.convergence(math.radians(LAT), math.radians(LON)))
    )
    assert math.remainder(true - 100.0, 360.0) == pytest.approx(0.0, abs=1e-9)
    assert found.values['initial_v_G'] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize('heading', [40.0, 200.0, -75.0])
def test_gyrocompass(heading: float) -> None:
    """Good gyros find north at 75 degrees; the sigma comes with it."""
    found = start(
        f'initial: {{from: alignment, rest_s: 30, heading: gyrocompass}}\n{PLACE}, '
        'gyro_bias_sigma: 1.454e-7}',
        resting(2.0, -3.0, heading),
    )
    assert found.findings == ()
    sigma = found.values['initial_sigma_heading_deg']
    assert sigma == pytest.approx(math.degrees(1.454e-7 / (7.292e-5 * math.cos(1.309))), rel=0.01)
    error = math.remainder(found.values['initial_grid_heading_deg'] - heading, 360.0)
    assert abs(error) < 4.0 * sigma


def test_gyrocompass_that_cannot() -> None:
    """A gyro of 10 deg/h sees no north here, and is told so with the number."""
    found = start(
        f'initial: {{from: alignment, rest_s: 30, heading: gyrocompass}}\n{PLACE}, '
        'gyro_bias_sigma: 4.8e-5}',
        resting(0.0, 0.0, 40.0, bias=4.8e-5),
    )
    (finding,) = found.findings
    assert (finding.name, finding.severity) == ('gyrocompass', Severity.SEVERE)
    assert finding.value > 100.0


def test_a_vehicle_that_is_not_at_rest() -> None:
    """Alignment at sea is refused."""
    imu = resting(0.0, 0.0, 0.0)
    t = imu.stamps_ns[:, None] * 1e-9
    moving = ImuRows('/imu', imu.stamps_ns, imu.log_ns, imu.omega_ib_b + 0.1 * np.sin(t), imu.f_b)
    found = start(f'initial: {{from: alignment, rest_s: 30, heading_deg: 0.0}}\n{PLACE}}}', moving)
    assert [f.name for f in found.findings] == ['not_at_rest']


def test_velocity_from_the_dvl() -> None:
    """Where nothing else tells, the first ping does, turned by the attitude found."""
    imu = resting(0.0, 0.0, 90.0)  # grid east: body x is grid x
    one = np.array([2 * S])
    yes = np.array([True])
    dvl = DvlRows('/d', one, one, np.array([[1.5, 0.2, 0.0]]), np.eye(3)[None], yes, yes)
    found = start(f'initial: {{grid_heading_deg: 90.0}}\n{PLACE}}}', imu, dvl)
    assert found.values['initial_v_G'] == pytest.approx([1.5, 0.2, 0.0], abs=1e-3)
    # Turning to port at 0.1 rad/s, a DVL 2 m ahead goes 0.2 m/s to port while base_link does not.
    turning = replace(imu, omega_ib_b=imu.omega_ib_b + np.array([0.0, 0.0, 0.1]))
    found = start(
        f'initial: {{grid_heading_deg: 90.0}}\n{PLACE}, dvl_lever_b: [2, 0, 0]}}', turning, dvl
    )
    assert found.values['initial_v_G'] == pytest.approx([1.5, 0.0, 0.0], abs=1e-3)


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        ('initial: {heading_deg: 0.0}', 'position comes from nowhere'),
        (f'{PLACE}}}', 'heading comes from nowhere'),
        (f'initial: {{from: alignment, rest_s: 0.1}}\n{PLACE}}}', 'heading comes from nowhere'),
    ],
)
def test_what_comes_from_nowhere(text: str, sentence: str) -> None:
    """No default stands in for a place or a heading."""
    values: dict[str, Any] = {'imu': resting(0.0, 0.0, 0.0)}
    with pytest.raises(ConfigError, match=sentence):
        start(text, **values)


@pytest.mark.parametrize(
    ('helped', 'lever_b'), [(True, (0, 0, 0)), (True, (3.0, -1.0, 0.5)), (False, (0, 0, 0))]
)
def test_levelling_of_a_vehicle_that_turns_and_speeds_up(
    helped: bool, lever_b: Sequence[float]
) -> None:
    """A banked, accelerating turn: with the DVL the vertical at the start is found anyway."""
    n, dt, g = 1001, 0.01, 9.83
    t = np.arange(n) * dt
    psi, speed = 0.1 * t + 0.01 * t**2, 2.0 + 0.1 * t
    C_b_G = attitude.matrix_from_euler(psi, np.full(n, -0.05), 0.1 + 0.03 * t)
    forward = np.column_stack([np.cos(psi), np.sin(psi), 0.0 * t])
    v_G = speed[:, None] * forward
    a_G = 0.1 * forward + (speed * (0.1 + 0.02 * t))[:, None] * np.column_stack(
        [-np.sin(psi), np.cos(psi), 0.0 * t]
    )
    f = np.einsum('nji,nj->ni', C_b_G, a_G + np.array([0.0, 0.0, g]))
    turns = np.swapaxes(C_b_G[:-1], 1, 2) @ C_b_G[1:]
    omega = attitude.log(turns) / dt
    omega = np.vstack([omega[:1], omega])
    stamps = S + np.round(t * S).astype(np.int64)
    v_b = np.einsum('nji,nj->ni', C_b_G, v_G) + np.cross(omega, lever_b)
    yes = np.ones(n, dtype=bool)
    dvl = DvlRows('/d', stamps, stamps, v_b, np.broadcast_to(np.eye(3), (n, 3, 3)), yes, yes)
    found = start(
        f'initial: {{heading_deg: 0.0, rest_s: 10}}\n{PLACE}}}',
        ImuRows('/imu', stamps, stamps, omega, f),
        dvl if helped else None,
        lever_b,
    )
    roll = found.values['initial_roll_deg'] - math.degrees(0.1)
    pitch = found.values['initial_pitch_deg'] + math.degrees(0.05)
    if helped:
        assert abs(roll) < 0.05
        assert abs(pitch) < 0.05
        assert found.values['initial_sigma_tilt_deg'] == 1.0
    else:
        # The turn pulls to one side, and the sigma says so.
        assert 1.0 < abs(roll) < 3.0 * found.values['initial_sigma_tilt_deg']
