"""Presets, parameter classes and the example files that repeat them."""

from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import from_mapping, to_mapping
from polar_nav_sim import params
from polar_nav_sim.sensors import presets

CONFIG = Path(__file__).parents[1] / 'config'
CLASSES = {
    'truth_node': params.TruthParams,
    'vehicle_node': params.VehicleParams,
    'station_node': params.StationParams,
    'imu_node': params.ImuParams,
    'dvl_node': params.DvlParams,
    'depth_node': params.DepthParams,
    'ahrs_node': params.AhrsParams,
    'usbl_node': params.UsblParams,
    'absolute_fix_node': params.AbsoluteFixParams,
    'leader_reference_node': params.LeaderReferenceParams,
    'acoustic_link_node': params.AcousticLinkParams,
}
FILES = {
    'imu_paper_6_2': presets.IMU['paper_6_2'],
    'imu_navigation': presets.IMU['navigation'],
    'imu_tactical': presets.IMU['tactical'],
    'imu_leader': presets.IMU['leader'],
    'dvl_leader': presets.DVL['leader'],
    'dvl_small': presets.DVL['small'],
    'usbl_small': presets.USBL['small'],
}


@pytest.mark.parametrize('file', sorted(CONFIG.glob('*.yaml')), ids=lambda f: f.stem)
def test_config_files_fit_their_nodes(file):
    for name, section in yaml.safe_load(file.read_text()).items():
        values = from_mapping(CLASSES[name.split('/')[-1]], section['ros__parameters'])
        if file.stem in FILES:
            for key, expected in to_mapping(FILES[file.stem].errors).items():
                assert getattr(values, key) == pytest.approx(
                    tuple(expected) if isinstance(expected, list) else expected, rel=1e-5
                )


def test_every_preset_has_a_source_and_a_default_exists():
    for table in (presets.IMU, presets.DVL, presets.USBL):
        assert all(p.source for p in table.values())
    assert presets.IMU['paper_6_1'].errors == type(presets.IMU['paper_6_1'].errors)()


@pytest.mark.parametrize('cls', CLASSES.values(), ids=CLASSES)
def test_parameters_have_text_and_defaults(cls):
    for f in fields(cls):
        assert f.metadata['doc']
    assert from_mapping(cls, to_mapping(cls())) == cls()


def test_out_of_range_is_named():
    with pytest.raises(ConfigError, match='range_sigma_m'):
        params.UsblParams(range_sigma_m=-1.0)
    with pytest.raises(ConfigError, match=r'gyro_bias_dph\[1\]'):
        params.ImuParams(gyro_bias_dph=(0.0, 1e9, 0.0))
    with pytest.raises(ConfigError, match='random_delay_mean_s'):
        params.AcousticLinkParams(random_delay_mean_s=9.0)
