"""A guessed mapping: instruments by class, clocks by the checks of stamps, what is to fill in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_worlds import (
    DVL,
    FIXES,
    IMU,
    Column,
    Recorder,
    S,
    imu_column,
    mapping,
    stamped,
    stamps_of,
    truth_of,
    write_columns,
)
from foreign_worlds import aiding_columns as aiding

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.sins.leader import LeaderError
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import default_of
from polar_nav_ros.adapters import mapping_file, noise_classes
from polar_nav_ros.adapters.fixes import fixes_of, sigma_covariance
from polar_nav_ros.adapters.position import PositionRows
from polar_nav_ros.adapters.section import Section
from polar_nav_sim.sensors import instruments
from polar_nav_sim.sensors.imu import DPH
from polar_nav_tools.foreign import instrument_noise
from polar_nav_tools.foreign.guess import guess
from polar_nav_tools.foreign.guess_noise import Choices
from polar_nav_tools.foreign.sources import open_source

KNOWN = Choices(imu='stim300', dvl='workhorse_1200', reference='bottom')
SIX_DAYS_NS = 514_944_040_000_000


@pytest.fixture(scope='module')
def columns() -> tuple[Recorder, list[Column]]:
    """Forty seconds of everything."""
    truth, make = truth_of(40.0), Recorder()
    imu = imu_column(make, truth, stamps_of(truth, 0.0, 40.0, 0.01))
    return make, [imu, *aiding(make, truth, 0.0, 40.0)]


def guessed(folder: Path, make: Recorder, some: list[Column], choices: Choices = KNOWN) -> str:
    """Write a bag and guess its mapping."""
    return guess(open_source(write_columns(folder / 'bag', make, some)), choices)


def with_stamps(c: Column, stamps_ns: Any) -> Column:
    """A topic with other header stamps."""
    return replace(c, values={**c.values, **stamped(stamps_ns)})


def test_every_class_has_every_parameter_within_its_limits() -> None:
    """One table for simulation and mapping: a class of the one is one of the other."""
    derived = {name: instrument_noise.imu_parameters(name) for name in noise_classes.IMU_CLASSES}
    assert derived == noise_classes.IMU
    derived = {name: instrument_noise.dvl_errors(name) for name in noise_classes.DVL_CLASSES}
    assert derived == noise_classes.DVL
    assert set(noise_classes.IMU_CLASSES) <= set(instruments.IMU)
    assert set(noise_classes.DVL_CLASSES) <= set(instruments.DVL)
    for name in noise_classes.IMU_CLASSES:
        EngineParams(**noise_classes.imu_noise(name))
    for name in noise_classes.DVL_CLASSES:
        EngineParams(**noise_classes.dvl_noise(name))


def test_noise_of_a_class_by_hand() -> None:
    """STIM300 and A50: what the table's numbers give by the rules beside the functions."""
    imu = noise_classes.imu_noise('stim300')
    assert imu['gyro_bias_sigma'] == pytest.approx(np.sqrt(5.0**2 + 0.5**2 + 1.0) * DPH)
    walk = np.hypot(0.5 * np.sqrt(2 / 1000), 0.25 * 11.8 / np.sqrt(1800)) * DPH
    assert imu['gyro_bias_walk'] == pytest.approx(np.hypot(walk, 7e-10))
    assert imu['accel_noise_density'] == pytest.approx(0.001)
    cross = np.hypot(3e-4, 1e-3)
    bias = np.sqrt(750e-6**2 + 50e-6**2 + cross**2) * 9.80665
    assert imu['accel_bias_sigma'] == pytest.approx(bias)
    a50 = noise_classes.dvl_noise('a50_standard')
    assert a50['dvl_scale_sigma'] == pytest.approx(np.hypot(0.01, 0.03))
    assert a50['dvl_markov_sigma'] == 0.02
    water = noise_classes.dvl_noise('a50_standard', water=True)
    assert water['dvl_markov_sigma'] == pytest.approx(np.hypot(0.02, 0.2))
    corrected = noise_classes.dvl_noise('a50_standard', corrected=True)
    assert corrected['dvl_scale_sigma'] == pytest.approx(np.hypot(0.01, 0.003))
    # A better class never has the larger numbers.
    order = ('navigation', 'fog', 'stim300', 'vn100', 'bmi088', 'icm20948')
    sigmas = [noise_classes.imu_noise(name)['gyro_bias_sigma'] for name in order]
    assert sigmas == sorted(sigmas)


def test_classes_are_written_as_numbers(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """With everything that the filter wants to know, and none of it the simulation's."""
    text = guessed(tmp_path, *columns)
    noise = yaml.safe_load(text)['noise']
    assert (noise.pop('imu'), noise.pop('dvl')) == ('stim300', 'workhorse_1200')
    wanted = {
        **noise_classes.imu_noise('stim300'),
        **noise_classes.dvl_noise('workhorse_1200'),
        **noise_classes.common_noise(),
    }
    assert noise == pytest.approx(wanted, rel=5e-3)
    assert 'Sensonor data sheet TS1524' in text
    assert yaml.safe_load(text)['version'] == 2


def test_what_nobody_said_is_to_be_filled_in(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """No noise is better than that of another instrument: the run is refused until it is there."""
    text = guessed(tmp_path, *columns, Choices())
    assert 'FILL IN which IMU it was' in text
    top = yaml.safe_load(text)
    known = mapping()
    top |= {name: known[name] for name in ('initial', 'truth', 'parameters')}
    top['parameters'] = {}
    assert top['dvl']['reference'] == 'FILL_IN'
    for section, key, value, options in (
        ('dvl', 'reference', 'bottom', 'bottom, water'),
        ('noise', 'imu', 'bmi088', 'bmi088, fog, icm20948'),
        ('noise', 'dvl', 'a50_performance', 'a50_performance, a50_standard'),
    ):
        says = f'{section}: {key}: is still to be filled in: {options}'
        with pytest.raises(ConfigError, match=says):
            mapping_file.from_section(Section('m', top))
        top[section][key] = value
    found = mapping_file.from_section(Section('m', top))
    assert found.params['gyro_bias_sigma'] == pytest.approx(3600 * DPH, rel=0.01)
    assert found.params['dvl_scale_sigma'] == 0.001
    assert found.params['fix_offset_sigma'] == default_of(EngineParams, 'fix_offset_sigma')


def test_numbers_win_over_their_class_and_stand_once() -> None:
    """A data sheet is better than a class; two places for one number are a mistake."""
    top = mapping() | {'parameters': {}, 'noise': {'imu': 'vn100', 'gyro_noise_density': 1e-4}}
    params = mapping_file.from_section(Section('m', top)).params
    assert params['gyro_noise_density'] == 1e-4
    assert params['accel_noise_density'] == noise_classes.imu_noise('vn100')['accel_noise_density']
    top['parameters'] = {'gyro_bias_sigma': 1e-5}
    with pytest.raises(ConfigError, match='gyro_bias_sigma is stated among parameters, too'):
        mapping_file.from_section(Section('m', top))
    with pytest.raises(ConfigError, match='noise: unknown key max_speed'):
        mapping_file.from_section(Section('m', mapping() | {'noise': {'max_speed': 1.0}}))


@pytest.mark.parametrize(
    ('version', 'stated', 'dimensions'),
    [
        (1, {}, 3),
        (2, {}, 2),
        (2, {'sigma': 5.0}, 2),
        (2, {'sigma': [5.0, 2.0]}, 3),
        (2, {'sigma': [5.0, 2.0], 'dimensions': 2}, 2),
        (1, {'dimensions': 2}, 2),
    ],
)
def test_fixes_are_2_d_from_version_2_on(version: int, stated: Any, dimensions: int) -> None:
    top = mapping() | {'version': version, 'fixes': {'topic': '/fix'} | stated}
    (fix,) = mapping_file.from_section(Section('m', top)).fixes
    assert fix.dimensions == dimensions


def test_a_slow_error_of_fixes_is_one_that_they_share() -> None:
    slow = {'topic': '/fix', 'slow_sigma': 2.0, 'correlation_s': 60}
    parsed = mapping_file.from_section(Section('m', mapping() | {'fixes': slow}))
    assert parsed.fixes[0].slow_sigma == 2.0
    assert parsed.params['leader_error_tau'] == 60.0
    r_e = np.array([[6378137.0, 0.0, 0.0]])
    rows = PositionRows(
        topic='/fix',
        type='',
        stamps_ns=np.array([10**9]),
        log_ns=np.array([10**9]),
        r_e=r_e,
        C_b_G=np.full((1, 3, 3), np.nan),
        v_G=np.full((1, 3), np.nan),
        covariance_e=sigma_covariance((1.0, 3.0), r_e),
        given=np.array([True]),
        plausible=np.array([True]),
        stated=True,
    )
    (fix,) = fixes_of(parsed.fixes[0], rows)
    assert fix.leader_sigma == 2.0
    np.testing.assert_allclose(fix.covariance_e, np.diag([9.0, 5.0, 5.0]), atol=1e-9)
    split = LeaderError(60.0).split(fix)
    np.testing.assert_allclose(split.covariance_e, np.diag([9.0, 1.0, 1.0]), atol=1e-9)


@pytest.mark.parametrize(
    ('fixes', 'parameters', 'says'),
    [
        ([{'slow_sigma': 2.0}], {}, 'slow_sigma: goes with correlation_s'),
        ([{'slow_sigma': 2.0, 'correlation_s': 0.5}], {}, 'slow_sigma: goes with correlation_s'),
        ([{'slow_sigma': 2.0, 'correlation_s': 60.0}, {}], {}, 'goes with one source of fixes'),
        (
            [{'slow_sigma': 2.0, 'correlation_s': 60.0}],
            {'leader_error_tau': 60.0},
            'stated among parameters, too',
        ),
        (
            [{'slow_sigma': 2.0, 'correlation_s': 60.0}],
            {'usbl_bias_sigma': 1.0},
            'does not go with usbl_bias_sigma',
        ),
    ],
)
def test_a_slow_error_is_stated_once_and_whole(fixes: Any, parameters: Any, says: str) -> None:
    sections = [{'topic': f'/fix{k}'} | one for k, one in enumerate(fixes)]
    top = mapping() | {'fixes': sections, 'parameters': parameters}
    with pytest.raises(ConfigError, match=says):
        mapping_file.from_section(Section('m', top))


@pytest.mark.parametrize(
    ('stated', 'says'),
    [
        ({'type': 'Imu'}, "'Imu' is no message type"),
        ({'clock': 'gps'}, "clock: 'gps' is none of host, sensor, log"),
        ({'clock': 'sensor', 'stamp': 'log'}, 'clock: sensor does not go with `stamp: log`'),
        ({'dimensions': 1}, 'unknown key dimensions'),
    ],
)
def test_keys_of_sources_are_checked(stated: Any, says: str) -> None:
    top = mapping()
    top['imu'] |= stated
    with pytest.raises(ConfigError, match=says):
        mapping_file.from_section(Section('m', top))


def test_versions_of_mappings() -> None:
    """One of a later project is refused; one without is the first."""
    assert mapping_file.from_section(Section('m', mapping() | {'version': 1})).vehicle == 'auv'
    with pytest.raises(ConfigError, match='version: 3 is of a later polar_nav'):
        mapping_file.from_section(Section('m', mapping() | {'version': 3}))


def test_a_stated_sound_speed_narrows_the_scale_of_an_a50(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """Both are needed, that of the instrument and that of the water; `map` names both."""
    top = mapping() | {'parameters': {}, 'noise': {'imu': 'fog', 'dvl': 'a50_standard'}}

    def scale() -> float:
        return float(mapping_file.from_section(Section('m', top)).params['dvl_scale_sigma'])

    assert scale() == pytest.approx(np.hypot(0.01, 0.03))
    top['parameters'] = {'water_sound_speed': 1440}
    assert scale() == pytest.approx(np.hypot(0.01, 0.03))
    top['dvl']['sound_speed'] = 1500
    assert scale() == pytest.approx(np.hypot(0.01, 0.003))
    top['dvl']['sound_speed'] = 150
    with pytest.raises(ConfigError, match=r'sound_speed.*1300, 1700'):
        scale()
    a50 = guessed(tmp_path, *columns, replace(KNOWN, dvl='a50_standard'))
    assert 'water_sound_speed' in a50
    assert 'dvl_scale_sigma is 0.0104' in a50


def test_velocity_through_the_water() -> None:
    """The class is widened by a current, however the mapping came about."""
    top = mapping() | {'parameters': {}, 'noise': {'imu': 'fog', 'dvl': 'a50_performance'}}
    top['dvl']['reference'] = 'water'
    found = mapping_file.from_section(Section('m', top))
    assert found.dvl is not None
    assert found.dvl.water
    assert found.params['dvl_markov_sigma'] == pytest.approx(np.hypot(0.02, 0.2))


def test_a_topic_on_another_clock_is_taken_by_its_log_times(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """Six days behind, and fixes of that clock are not six days late; the digits are all there."""
    make, (imu, dvl, depth, fixes, truth) = columns
    other = with_stamps(dvl, dvl.log_ns - SIX_DAYS_NS)
    slow = with_stamps(fixes, fixes.log_ns - SIX_DAYS_NS)
    text = guessed(tmp_path, make, [imu, other, depth, slow, truth])
    top = yaml.safe_load(text)
    assert top['dvl']['stamp'] == 'log'
    assert '`time_offset_s: 514944.04` keeps the spacing' in text
    navsat = {'topic': FIXES, 'type': 'sensor_msgs/msg/NavSatFix', 'dimensions': 2}
    assert top['fixes'] == [navsat | {'time_offset_s': 'FILL_IN'}]
    assert 'recorded 514944.04 s (5.96 days) after their stamps: another' in text
    assert 'stamp' not in top['imu']
    assert 'stamp' not in top['depth']
    kept = Choices('stim300', 'workhorse_1200', 'bottom', clock='header')
    top = yaml.safe_load(guessed(tmp_path / 'kept', make, [imu, other, depth], kept))
    assert 'stamp' not in top['dvl']


def test_a_recording_whose_clocks_are_all_another(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """A bag that was played and recorded again: stamps agree with one another, and are kept."""
    make, some = columns
    later = [replace(c, log_ns=c.log_ns + SIX_DAYS_NS) for c in some]
    text = guessed(tmp_path, make, later)
    assert 'stamp: log' not in text
    assert 'recorded 8 s after their stamps' in text


def test_stamps_that_nobody_filled_in(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """The check of `replay` is run here, too, and the way out is taken."""
    make, (imu, dvl, *others) = columns
    zero = with_stamps(imu, np.zeros(len(imu.log_ns), dtype=np.int64))
    back = dvl.log_ns.copy()
    back[50] -= 10 * S
    text = guessed(tmp_path, make, [zero, with_stamps(dvl, back), *others])
    top = yaml.safe_load(text)
    assert top['imu']['stamp'] == 'log'
    assert f'# CHECK severe: stamps_zero: {len(zero.log_ns)} of' in text
    assert '# CHECK severe: stamps_backwards: 1 stamps are before' in text
    assert 'stamp' not in top['dvl']


def test_an_imu_of_zeros_and_fixes_without_a_position(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """Neither is guessed from: no axes out of no gravity, no delay of fixes that hold nothing."""
    make, (imu, dvl, depth, fixes, truth) = columns
    still = replace(
        imu,
        values={n: 0 * v if n.partition('.')[0] != 'header' else v for n, v in imu.values.items()},
    )
    empty = replace(fixes, values={**fixes.values, 'latitude': np.full(len(fixes.log_ns), np.nan)})
    text = guessed(tmp_path, make, [still, dvl, depth, empty, truth])
    top = yaml.safe_load(text)
    assert top['imu'] | {'topic': IMU, 'rotation': 'FILL_IN'} == top['imu']
    assert f'zero in all {len(imu.log_ns)} messages' in text
    assert 'fixes' not in top
    assert f'# {FIXES}: 2 of 2 messages hold no position' in text


def test_a_bare_number_for_the_depth(
    columns: tuple[Recorder, list[Column]], tmp_path: Path
) -> None:
    """No header and no unit: the log times, and a unit to fill in."""
    make, (imu, dvl, depth, *_) = columns
    bare = Column(
        '/auv/pressure',
        'std_msgs/msg/Float64',
        depth.log_ns,
        make.make('std_msgs/msg/Float64', data=0.0),
        {'data': depth.values['fluid_pressure']},
    )
    text = guessed(tmp_path, make, [imu, dvl, bare])
    top = yaml.safe_load(text)
    assert top['depth'] | {'stamp': 'log', 'unit': 'FILL_IN'} == top['depth']
    assert 'FILL IN the unit: not in the type, the median is 1.1' in text
    assert top['dvl']['topic'] == DVL
