"""Pages whose tables name parameters and keys of mapping files: each exists."""

import re
from pathlib import Path

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.section import Section

DOCS = Path(__file__).parents[2] / 'docs'


def names_in(page: str, column: int, after: str) -> set[str]:
    """Names in one column of the tables of three columns that follow some words of a page."""
    rows = (DOCS / page).read_text(encoding='utf-8').split(after, 1)[1].splitlines()
    cells = [row.split('|') for row in rows if row.startswith('|')]
    found = [c[column] for c in cells if len(c) == 5]
    return {name for cell in found for name in re.findall(r'`([^`]+)`', cell)}


FROM_OTHERS = names_in('from-robot-localization.md', 3, '## Inputs')
DATA_SHEET = names_in('your-vehicle.md', 2, '| data sheet |')
KEYS = sorted(name for name in FROM_OTHERS | DATA_SHEET if ':' in name)


def parameters_of(node: str) -> set[str]:
    """Names of a node's parameters, by the generated page."""
    section = (DOCS / 'parameters.md').read_text().split(f'\n## {node}\n')[1].split('\n## ')[0]
    return set(re.findall(r'^\| `(\w+)`', section, re.MULTILINE))


@pytest.mark.parametrize(('names', 'least'), [(FROM_OTHERS, 30), (DATA_SHEET, 20)])
def test_each_parameter_exists(names: set[str], least: int) -> None:
    ours = {name for name in names if ':' not in name}
    assert len(ours) > least
    assert ours - parameters_of('follower_node') == set()


@pytest.mark.parametrize('name', KEYS)
def test_each_key_of_a_mapping_exists(name: str) -> None:
    """A value that no key takes is refused for itself, not as an unknown key."""
    section, key = name.split(': ')
    top = {'imu': {'topic': '/imu'}, 'dvl': {'topic': '/dvl'}, 'fixes': {'topic': '/fix'}}
    top['heading'] = {'topic': '/imu', 'reference': 'magnetic', 'declination_applied_deg': 0.0}
    top.setdefault(section, {'topic': '/topic'})
    top[section] = {**top[section], key: {'no': 'such value'}}
    with pytest.raises(ConfigError) as refused:
        mapping_file.from_section(Section('m', top))
    assert f'unknown key {key}' not in str(refused.value)
