"""The reference pages say what the code says."""

from pathlib import Path

import pytest

pytest.importorskip('rclpy')

from polar_nav_tools.development import pages as reference

DOCS = Path(__file__).parents[2] / 'docs'


@pytest.mark.parametrize(
    ('name', 'page'),
    [('parameters.md', reference.parameters_page), ('packet.md', reference.packet_page)],
)
def test_page_is_what_the_code_makes(name, page):
    assert (DOCS / name).read_text(encoding='utf-8') == page(), (
        'write it anew: python -m polar_nav_tools.development.pages docs'
    )
