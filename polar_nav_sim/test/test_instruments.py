"""Instruments that can be bought: sources, lookup from a mission, what is refused."""

import math

import numpy as np
import pytest
from sim_chances import inside

from polar_nav_core.errors import ConfigError
from polar_nav_sim.mission import load_mission
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors import instruments, presets
from polar_nav_sim.sensors.imu import DPH, MICRO_G, ImuSensor

NEW_IMU = sorted(set(instruments.IMU) - set(presets.IMU))
TABLES = (
    instruments.IMU, instruments.DVL, instruments.USBL, instruments.DEPTH, instruments.HEADING,
    instruments.AHRS, instruments.ABSOLUTE,
)  # fmt: skip


def test_what_is_asked_for_is_there_with_a_source():
    assert {'stim300', 'fog', 'vn100', 'bmi088', 'icm20948', *presets.IMU} == set(instruments.IMU)
    assert {
        'a50_standard', 'a50_performance', 'workhorse_1200', 'workhorse_300', 'pathfinder_600',
    } <= set(instruments.DVL)  # fmt: skip
    assert {'ship', 'mid', 'seatrac'} <= set(instruments.USBL)
    assert {'octans', 'phins'} <= set(instruments.HEADING)
    for table in TABLES:
        assert all(len(p.source) > 10 for p in table.values())
    assert all(instruments.IMU[k] is v for k, v in presets.IMU.items())


@pytest.mark.parametrize('name', NEW_IMU)
def test_constants_of_an_imu_have_their_sigma(name):
    e = instruments.IMU[name].errors
    n, T = 300, 0.01
    x = []
    for seed in range(n):
        sensor = ImuSensor(e, T, stream(seed, name))
        omega, f = sensor.measure(0, np.zeros((1, 3)), np.zeros((1, 3)))
        x.append([*omega[0], *f[0]])
    gyro = np.hypot(e.gyro_turn_on_sigma_dph, e.gyro_instability_sigma_dph) * DPH
    accel = np.hypot(e.accel_turn_on_sigma_ug, e.accel_instability_sigma_ug) * MICRO_G
    white = [e.gyro_noise_density[0] / math.sqrt(T), e.accel_noise_density[0] / math.sqrt(T)]
    assert inside(np.array(x), np.repeat(np.hypot([gyro, accel], white), 3))


def test_a_gyrocompass_is_worse_nearer_to_a_pole():
    octans = instruments.HEADING['octans'].errors
    # 0.58 deg at 80 deg, as the secant has it.
    assert octans.at(math.radians(80.0)).heading_sigma_deg == pytest.approx(0.576, abs=1e-3)
    assert octans.at(math.radians(-80.0)).heading_sigma_deg == pytest.approx(0.576, abs=1e-3)
    assert octans.at(math.radians(90.0)).heading_sigma_deg == pytest.approx(103.9, abs=0.1)


def installed(values, vehicle='leader', mission='demo'):
    key = f'vehicles.{vehicle}.instruments'
    return load_mission(mission).with_overrides({key: values}).instruments(vehicle)


def test_a_mission_names_presets_and_changes_them():
    found = installed(
        {
            'imu': 'stim300',
            'dvl': {'preset': 'a50_standard', 'bad_ping_probability': 0.05, 'rate_hz': 8},
            'depth': {'bias_m': 1},
            'heading': {'preset': 'octans', 'heading_bias_deg': 2.0},
        }
    )
    assert found['imu'].errors == instruments.IMU['stim300'].errors
    assert found['imu'].rate_hz is None
    dvl = found['dvl']
    assert (dvl.errors.assumed_sound_speed, dvl.errors.bad_ping_probability) == (1500.0, 0.05)
    assert dvl.rate_hz == 8.0
    assert found['depth'].errors.bias_m == 1.0
    assert found['heading'].errors.heading_sigma_deg == pytest.approx(0.576, abs=1e-2)
    assert found['heading'].errors.heading_bias_deg == 2.0
    assert installed({'dvl': 'workhorse_300'}, 'follower')['dvl'].rate_hz == 2.0
    assert load_mission('demo').instruments('follower') == {}


def test_a_vehicle_with_dynamics_may_have_them_too():
    assert 'imu' in installed({'imu': 'fog'}, 'follower', 'model_aided')


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'imus': 'stim300'}, ('imus', 'imu')),
        ({'imu': 'stim3000'}, ('stim3000', 'stim300', 'navigation')),
        ({'dvl': {'preset': 'a50_standard', 'scale_sigm': 0.1}}, ('dvl', 'scale_sigm')),
        ({'dvl': {'scale_sigma': 9.0}}, ('dvl', 'scale_sigma', '9.0')),
        ({'dvl': {'rate_hz': 0.0}}, ('dvl', 'rate_hz')),
        ({'imu': {'rate_hz': 10.0}}, ('imu', 'rate_hz')),
        ({'usbl': 'ship'}, ('usbl', 'leader')),
        ({'imu': 3}, ('imu', '3')),
        ('stim300', ('instruments', 'stim300')),
    ],
)
def test_mistakes_are_named(values, words):
    with pytest.raises(ConfigError) as error:
        load_mission('demo').with_overrides({'vehicles.follower.instruments': values})
    for word in ('demo.yaml', 'vehicles.follower.instruments', *words):
        assert word in str(error.value)
