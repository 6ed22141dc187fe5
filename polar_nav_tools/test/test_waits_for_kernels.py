"""Commands that start nodes, or measure, wait for kernels that are compiled in the background."""

import pytest

from polar_nav_core import background
from polar_nav_tools.cli import bench, development, live


class Waits(Exception):
    pass


@pytest.mark.parametrize(
    ('command', 'arguments', 'what'),
    [
        (live.demo, {}, 'demo waits'),
        (live.launch, {}, 'launch waits'),
        (bench.core, {'processor': 0}, 'measurements wait'),
        (development.run_tests, {'context': None}, 'tests wait'),
    ],
)
def test_command_waits_before_it_begins(command, arguments, what, monkeypatch):
    said = []

    def wait(what):
        said.append(what)
        raise Waits

    monkeypatch.setattr(background, 'wait', wait)
    with pytest.raises(Waits):
        command(**arguments)
    assert said == [what]
