"""The page "Coming from robot_localization" names parameters and keys that exist."""

import re
from pathlib import Path

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.section import Section

DOCS = Path(__file__).parents[2] / 'docs'
ROW = re.compile(r'^\| `?[^|]+\|[^|]+\|([^|]*)\|$', re.MULTILINE)
NAMES = sorted(
    {
        name
        for cell in ROW.findall((DOCS / 'from-robot-localization.md').read_text())
        for name in re.findall(r'`([^`]+)`', cell)
    }
)


def parameters_of(node: str) -> set[str]:
    """Names of a node's parameters, by the generated page."""
    section = (DOCS / 'parameters.md').read_text().split(f'\n## {node}\n')[1].split('\n## ')[0]
    return set(re.findall(r'^\| `(\w+)`', section, re.MULTILINE))


def test_each_parameter_exists() -> None:
    ours = {name for name in NAMES if ':' not in name}
    assert len(ours) > 30
    assert ours <= parameters_of('follower_node')


@pytest.mark.parametrize('name', [name for name in NAMES if ':' in name])
def test_each_key_of_a_mapping_exists(name: str) -> None:
    """A value that no key takes is refused for itself, not as an unknown key."""
    section, key = name.split(': ')
    top = {'imu': {'topic': '/imu'}, 'dvl': {'topic': '/dvl'}, 'fixes': {'topic': '/fix'}}
    top.setdefault(section, {'topic': '/topic'})
    top[section] = {**top[section], key: {'no': 'such value'}}
    with pytest.raises(ConfigError) as refused:
        mapping_file.from_section(Section('m', top))
    assert f'unknown key {key}' not in str(refused.value)
