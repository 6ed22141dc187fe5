"""The contracts of pyproject.toml leave no module of the core and the tools without a floor."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
TOOLS = ROOT / 'polar_nav_tools' / 'polar_nav_tools'
TABLE = tomllib.loads((ROOT / 'pyproject.toml').read_text(encoding='utf-8'))
CONTRACTS = TABLE['tool']['importlinter']['contracts']


def test_one_module_stands_loose_at_the_root_of_the_tools():
    assert [p.stem for p in TOOLS.glob('*.py') if p.stem != '__init__'] == ['demo']


def test_contracts_of_rooms_name_every_module():
    rooms = [c for c in CONTRACTS if 'containers' in c]
    assert [c['containers'][0] for c in rooms] == [
        'polar_nav_core',
        'polar_nav_core.engine',
        'polar_nav_tools',
    ]
    assert all(c['exhaustive'] for c in rooms)


def test_circles_are_forbidden_without_an_exception():
    (circles,) = (c for c in CONTRACTS if c['type'] == 'acyclic_siblings')
    assert set(circles['ancestors']) == set(TABLE['tool']['importlinter']['root_packages'])
    assert not circles.keys() & {'ignore_imports', 'skip_descendants'}
