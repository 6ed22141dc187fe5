"""The files of three vehicles: the reader takes them, every name in them is a parameter's."""

from pathlib import Path

import pytest
import yaml

from polar_nav_core.params import from_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import inputs_of
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.live import Sources
from polar_nav_ros.adapters.mapping import VERSION
from polar_nav_ros.adapters.stated import parameters_of, settled
from polar_nav_ros.topics import DEPTH, DVL, HEADING, IMU

CONFIG = Path(__file__).parents[1] / 'config'
FIXES = {'bluerov2': '/ugps/fix', 'survey_auv': '/modem/usbl_fix', 'polar_pair': 'acomms/rx'}
ALIGNED = ('bluerov2',)
"""Those that state no place and no heading: fixes and a compass find them."""


def stated(vehicle):
    """Parameters of a vehicle's YAML file, for any node."""
    content = yaml.safe_load((CONFIG / f'{vehicle}_params.yaml').read_text(encoding='utf-8'))
    assert set(content) == {'/**'}
    return content['/**']['ros__parameters']


def test_there_are_three_vehicles():
    found = {path.name.removesuffix('_mapping.yaml') for path in CONFIG.glob('*_mapping.yaml')}
    assert found == set(FIXES)


@pytest.mark.parametrize('vehicle', FIXES)
def test_a_follower_starts_with_the_files_of_a_vehicle(vehicle):
    text, mapping = mapping_file.read(CONFIG / f'{vehicle}_mapping.yaml')
    assert f'version: {VERSION}\n' in text
    given = stated(vehicle)
    params = from_mapping(FollowerParams, {**parameters_of(mapping, given), **given})
    params = settled(params, {*given, *mapping.params}, mapping)
    aligned = vehicle in ALIGNED
    assert params.initialize == ('alignment' if aligned else 'parameters')
    sources = Sources(mapping, params)
    measured = {IMU, DVL, DEPTH, HEADING} if aligned else {IMU, DVL, DEPTH}
    assert {s.topic for s in sources} == {*measured, FIXES[vehicle]}
    assert all(s.stream.type for s in sources), 'a running vehicle needs the types'
    assert {IMU, DVL, DEPTH} <= set(inputs_of(params, sources))


@pytest.mark.parametrize('vehicle', FIXES)
def test_nothing_is_stated_in_both_files_of_a_vehicle(vehicle):
    content = yaml.safe_load((CONFIG / f'{vehicle}_mapping.yaml').read_text(encoding='utf-8'))
    assert not content['parameters'].keys() & stated(vehicle).keys()
