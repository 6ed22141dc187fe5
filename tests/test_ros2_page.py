"""Lists in docs/ros2-cli.md that the code determines; the transcripts need a real ros2."""

from pathlib import Path

import pytest
from live_support import NODES

from polar_nav_core.engine.configurations import NAMES

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / 'docs' / 'ros2-cli.md').read_text(encoding='utf-8')
LAUNCH = (ROOT / 'polar_nav_tools' / 'launch' / 'demo.launch.py').read_text(encoding='utf-8')


def test_missions_configurations_and_programs_are_those_of_the_code():
    missions = sorted(path.stem for path in (ROOT / 'polar_nav_sim' / 'missions').glob('*.yaml'))
    assert f'neither a file nor one of {", ".join(missions)}\n' in PAGE
    assert f'Valid choices are: {list(NAMES)}' in PAGE
    programs = ''.join(f'polar_nav_sim {name}\n' for name in sorted(NODES['polar_nav_sim']))
    assert f'$ ros2 pkg executables polar_nav_sim\n{programs}```' in PAGE


@pytest.mark.parametrize(
    'name', [part.split("'")[1] for part in LAUNCH.split('DeclareLaunchArgument(\n')[1:]]
)
def test_every_argument_of_the_launch_file_is_shown(name):
    assert f"    '{name}':\n" in PAGE
