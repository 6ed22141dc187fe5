"""The reference pages say what the code says."""

import re
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

from polar_nav_tools.development import pages as reference

ROOT = Path(__file__).parents[2]
DOCS = ROOT / 'docs'
PLACE = re.compile(r'`((?:core|ros|follower|leader|sim|tools)/[\w/]*(?:\.py)?)`')
FILE = re.compile(r'`([\w/]+\.(?:py|msg|json))`')
STEP = re.compile(r'^\| `(\w+/[\w/]+\.py)` \| ([^|]+) \|', re.MULTILINE)


@pytest.mark.parametrize(
    ('name', 'page'),
    [
        ('parameters.md', reference.parameters_page),
        ('packet.md', reference.packet_page),
        ('figures/house.svg', reference.house_figure),
    ],
)
def test_page_is_what_the_code_makes(name, page):
    assert (DOCS / name).read_text(encoding='utf-8') == page(), (
        'write it anew: python -m polar_nav_tools.development.pages docs'
    )


def path_of(place):
    package, _, rest = place.partition('/')
    name = f'polar_nav_{package}'
    return ROOT / name / name / rest


def architecture():
    return (DOCS / 'architecture.md').read_text(encoding='utf-8')


def test_architecture_names_files_that_exist():
    places = set(PLACE.findall(architecture()))
    assert len(places) > 30
    assert [p for p in sorted(places) if not path_of(p).exists()] == []


def test_architecture_names_files_by_the_ends_of_their_paths():
    """Names without a package, as `sins/streams.py` or `test_batch.py`."""
    short = {p for p in FILE.findall(architecture()) if not PLACE.fullmatch(f'`{p}`')}
    assert len(short) > 15
    packages = [p for p in ROOT.iterdir() if p.name.startswith('polar_nav_') or p.name == 'tests']
    files = [f'/{f.relative_to(ROOT).as_posix()}' for p in packages for f in p.rglob('*.*')]
    assert [p for p in sorted(short) if not any(f.endswith(f'/{p}') for f in files)] == []


def test_walks_name_functions_of_their_files():
    steps = [
        (place, name)
        for place, names in STEP.findall(architecture())
        for name in re.findall(r'`(\w+)`', names)
    ]
    assert len(steps) > 30
    missing = [
        (place, name)
        for place, name in steps
        if not re.search(rf'(def|class) {name}\b', path_of(place).read_text(encoding='utf-8'))
    ]
    assert missing == []
