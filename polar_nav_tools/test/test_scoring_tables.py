"""One table in the terminal, Markdown, CSV and JSON."""

import io

import numpy as np
import pytest
from rich.console import Console

from polar_nav_tools.scoring import Column, Table
from polar_nav_tools.scoring.json_values import jsonable
from polar_nav_tools.scoring.tables import show

TABLE = Table(
    'Errors',
    (Column('name', 'run'), Column('r', 'r x', 'm'), Column('n', 'fixes')),
    ({'name': 'a|b', 'r': 15.0625, 'n': 3}, {'name': '[bold]c', 'r': float('nan')}),
    note='two runs',
)


@pytest.mark.parametrize(
    ('value', 'text'),
    [
        (0.0123456, '0.0123'),
        (15.06, '15.1'),
        (999.6, '1000'),
        (0.09996, '0.100'),
        (123456.0, '123456'),
        (1234567.0, '1.23e+06'),
        (0.00001234, '1.23e−05'),
        (-0.5, '−0.500'),
        (0.0, '0'),
        (float('nan'), '–'),
        (float('inf'), '∞'),
        (None, '–'),
        (7, '7'),
        (np.int64(7), '7'),
        (True, 'yes'),
        (np.bool_(False), 'no'),
        ('text', 'text'),
    ],
)
def test_show(value, text):
    assert show(value) == text


def test_markdown():
    assert TABLE.to_markdown().splitlines() == [
        '**Errors**',
        '',
        '| run     | r x [m] | fixes |',
        '| ------- | ------: | ----: |',
        '| a\\|b    |    15.1 |     3 |',
        '| [bold]c |       – |     – |',
        '',
        'two runs',
    ]


def test_csv_keeps_every_digit():
    assert TABLE.to_csv() == 'name,r,n\na|b,15.0625,3\n[bold]c,,\n'


def test_terminal_shows_text_as_it_is():
    out = io.StringIO()
    Console(file=out, width=80).print(TABLE.to_rich())
    text = out.getvalue()
    assert '[bold]c' in text
    assert '15.1' in text
    assert 'two runs' in text


def test_json_has_null_for_nan():
    assert TABLE.to_dict()['rows'] == [
        {'name': 'a|b', 'r': 15.0625, 'n': 3},
        {'name': '[bold]c', 'r': None, 'n': None},
    ]
    assert jsonable({'a': np.array([1.0, np.nan]), 'b': (np.int8(1), np.True_)}) == {
        'a': [1.0, None],
        'b': [1, True],
    }


def test_mistakes_are_named():
    with pytest.raises(ValueError, match="no column for \\['x'\\]"):
        Table('t', (Column('a', 'a'),), ({'x': 1},))
    with pytest.raises(ValueError, match='not unique'):
        Table('t', (Column('a', 'a'), Column('a', 'b')), ())
