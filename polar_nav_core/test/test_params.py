"""Parameters: one place for default, unit, range and text; what is wrong is named."""

from dataclasses import dataclass

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import (
    NodeParams,
    choice,
    flag,
    from_mapping,
    param,
    text,
    texts,
    to_mapping,
    vector,
)


@dataclass(frozen=True)
class Example(NodeParams):
    rate: float = param(5.0, 'Hz', 0.1, 100.0, 'How often')
    count: int = param(3, '', 0, 10, 'How many')
    lever: tuple = vector((0.0, 1.0, 2.0), 'm', -10.0, 10.0, 'Where')
    mode: str = choice('slow', ('slow', 'fast'), 'How')
    on: bool = flag(True, 'Whether')
    name: str = text('x', 'Who')
    names: tuple = texts((), 'Who else')


def test_defaults_pass_and_round_trip():
    values = to_mapping(Example())
    assert values['lever'] == [0.0, 1.0, 2.0]
    assert from_mapping(Example, values) == Example()


@pytest.mark.parametrize(
    ('changes', 'says'),
    [
        ({'rate': 0.0}, r'rate: 0.0 is outside of \[0.1, 100.0\] Hz'),
        ({'rate': float('nan')}, 'rate: nan'),
        ({'rate': 5}, 'write 5.0, not 5'),
        ({'count': 11}, 'count: 11'),
        ({'count': 1.5}, 'count: 1.5 is not an integer'),
        ({'lever': [0.0, 1.0]}, 'lever.* list of 3'),
        ({'lever': [0.0, 1.0, 20.0]}, r'lever\[2\]: 20.0'),
        ({'mode': 'medium'}, "mode: 'medium' is none of slow, fast"),
        ({'on': 1}, 'on: 1 is neither'),
        ({'name': 3}, 'name: 3 is not a text'),
        ({'names': 'one'}, 'names'),
        ({'speed': 1.0}, 'unknown parameter speed'),
    ],
)
def test_what_is_wrong_is_named(changes, says):
    with pytest.raises(ConfigError, match=says):
        from_mapping(Example, changes)
