"""Parameters: one place for default, unit, range and text; what is wrong is named."""

from dataclasses import dataclass

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import (
    NodeParams,
    choice,
    flag,
    from_mapping,
    names_near,
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
        (
            {'published_depth_variance': 1e-3},
            'of Example was retired with engine 1: it had no effect; .* or depth_sigma squared',
        ),
        ({'speed': 1.0}, 'unknown parameter speed of Example; there are count, lever, '),
    ],
)
def test_what_is_wrong_is_named(changes, says):
    with pytest.raises(ConfigError, match=says):
        from_mapping(Example, changes)


@pytest.mark.parametrize(
    ('name', 'says'),
    [
        ('gate_propability', 'did you mean gate_probability? docs/parameters.md lists all 17'),
        ('delay', 'did you mean max_delay_s? docs/parameters.md lists all 17'),
        ('k', 'did you mean k00 or k01 or k02? docs/parameters.md lists all 17'),
        ('colour', 'docs/parameters.md lists all 17'),
        # Not model_mass, which has as many letters in common with it as a word of chance has.
        ('max_dely_s', 'did you mean max_delay_s? docs/parameters.md lists all 17'),
        ('delay_max_s', 'did you mean max_delay_s? docs/parameters.md lists all 17'),
        ('gate', 'did you mean gate_probability? docs/parameters.md lists all 17'),
        ('gyro_bias', 'did you mean gyro_bias_sigma or gyro_bias_tau? docs/parameters.md lists'),
    ],
)
def test_of_many_names_the_nearest_are_told(name, says):
    known = ['gate_probability', 'max_delay_s', 'model_mass', 'gyro_bias_sigma', 'gyro_bias_tau']
    known += [f'k{i:02d}' for i in range(12)]
    assert names_near(name, known).startswith(says)
