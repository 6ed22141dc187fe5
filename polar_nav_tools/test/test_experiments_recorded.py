"""Errors of a resting IMU out of a bag."""

import json
import sys

import numpy as np
import pytest
from bag_samples import START_NS, TYPES, make, stamp

from polar_nav_core import earth
from polar_nav_core.errors import ConfigError, PolarNavError
from polar_nav_sim.sensors.imu import DPH
from polar_nav_tools.bags import BagWriter
from polar_nav_tools.cli import main
from polar_nav_tools.experiments.recorded import (
    RestSpec,
    load_recorded,
    read_rest,
    save_recorded,
)

IMU = TYPES['/follower/imu/data_raw']
LATITUDE_DEG, HEADING_DEG = 45.73, 30.0
BIAS = np.array([1.0, -2.0, 3.0]) * DPH
COUNT, RATE_HZ = 400, 100


def write_rest(directory, topics=('imu',), *, gap=0, tilt=0.0):
    """A level IMU at rest whose x axis points 30 degrees east of north, left axis to the left."""
    rng = np.random.default_rng(5)
    lat, psi = np.radians(LATITUDE_DEG), np.radians(HEADING_DEG)
    rate = earth.OMEGA_IE
    earth_b = rate * np.array([np.cos(lat) * np.cos(psi), np.cos(lat) * np.sin(psi), np.sin(lat)])
    gravity = float(earth.gravity(np.asarray(earth.ecef_from_geodetic(lat, 0.0, 0.0), float)))
    noise = 1e-9 * rng.normal(size=(COUNT, 3))
    writer = BagWriter(directory, {}, chunk_bytes=8192, flush_s=1e9)
    for topic in topics:
        writer.add_topic(f'/{topic}', IMU)
        for k in range(COUNT):
            omega = earth_b + BIAS + noise[k]
            ns = START_NS + k * 10**9 // RATE_HZ + (gap if k > COUNT // 2 else 0)
            message = make(
                IMU,
                **stamp(ns),
                angular_velocity__x=omega[0],
                angular_velocity__y=omega[1],
                angular_velocity__z=omega[2],
                linear_acceleration__x=tilt,
                linear_acceleration__z=gravity + 2e-3,
            )
            writer.write(f'/{topic}', message, ns, ns)
    writer.finish({})
    return directory, noise


def test_without_its_mean_only_noise_is_left(tmp_path):
    bag, noise = write_rest(tmp_path / 'bag')
    errors = read_rest(bag, RestSpec())
    assert errors.rate_hz == RATE_HZ
    assert errors.duration_s == pytest.approx(4.0)
    np.testing.assert_allclose(errors.omega_b, noise - noise.mean(axis=0), atol=1e-15)
    assert np.abs(errors.f_b).max() < 1e-12
    gyro, accel = errors.noise_density()
    assert gyro == pytest.approx(1e-9 / np.sqrt(RATE_HZ), rel=0.1)
    assert accel == 0.0


def test_a_mean_that_is_kept_is_the_bias_without_the_earth(tmp_path):
    bag, _ = write_rest(tmp_path / 'bag')
    rest = RestSpec(mean='keep', latitude_deg=LATITUDE_DEG, heading_deg=HEADING_DEG)
    errors = read_rest(bag, rest)
    np.testing.assert_allclose(errors.omega_b.mean(axis=0), BIAS, atol=1e-9)
    np.testing.assert_allclose(errors.f_b.mean(axis=0), [0.0, 0.0, 2e-3], atol=1e-9)
    assert errors.largest_mean()[0] == pytest.approx(3.0 * DPH, rel=1e-3)
    kept = read_rest(bag, RestSpec(mean='keep', earth_rate='keep', latitude_deg=LATITUDE_DEG))
    left = np.linalg.norm(kept.omega_b.mean(axis=0) - BIAS)
    assert left == pytest.approx(earth.OMEGA_IE, rel=1e-6)


def test_errors_survive_their_file(tmp_path):
    bag, _ = write_rest(tmp_path / 'bag')
    errors = read_rest(bag, RestSpec(topic='/imu'))
    again = load_recorded(save_recorded(errors, tmp_path / 'errors.npz'))
    np.testing.assert_array_equal(again.omega_b, errors.omega_b)
    assert again.rate_hz == errors.rate_hz


@pytest.mark.slow
def test_table3_runs_on_a_recording_and_says_how_long_it_is(monkeypatch, capsys, tmp_path):
    bag, _ = write_rest(tmp_path / 'bag')
    arguments = ['polar', 'experiment', 'imu-errors', str(bag), '--duration', '12']
    arguments += ['--seeds', '1', '--columns', 'modified_akf', '--jobs', '1']
    monkeypatch.setattr(sys, 'argv', [*arguments, '--out', str(tmp_path / 'out')])
    assert main() == 0
    assert '4 s of IMU errors at 100 Hz' in capsys.readouterr().err
    text = (tmp_path / 'out' / 'table3.md').read_text()
    assert 'IMU errors recorded at rest, 4 s, used again and again.' in text
    manifest = json.loads((tmp_path / 'out' / 'manifest.json').read_text())
    world = manifest['groups']['D']['world']
    assert (world['imu'], world['imu_rate_hz']) == ('recorded', 100.0)
    assert manifest['recorded_imu'].endswith('imu_errors.npz')


def test_recordings_that_do_not_fit_are_named(tmp_path):
    two, _ = write_rest(tmp_path / 'two', topics=('a', 'b'))
    with pytest.raises(ConfigError, match=r'--topic: .*/a, /b'):
        read_rest(two, RestSpec())
    torn, _ = write_rest(tmp_path / 'torn', gap=3 * 10**9)
    with pytest.raises(PolarNavError, match='/imu: samples do not come evenly'):
        read_rest(torn, RestSpec())
    pushed, _ = write_rest(tmp_path / 'pushed', tilt=8.0)
    with pytest.raises(PolarNavError, match='is not that of rest'):
        read_rest(pushed, RestSpec(mean='keep'))
