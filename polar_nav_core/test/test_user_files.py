"""Files that a user names: every content gets an answer."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import MOST_NESTED, parse_yaml, read_text, read_yaml, regular

_LAUGHS = 'a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'a{i}: &a{i} [' + ', '.join([f'*a{i - 1}'] * 10) + ']\n' for i in range(1, 9)
)
"""Nine lines that stand for 10^9 values."""


def test_plain_values() -> None:
    text = 'a: [1, 2.5, x]\nb: {c: true, d: null}\n'
    assert parse_yaml(text, 'x') == {'a': [1, 2.5, 'x'], 'b': {'c': True, 'd': None}}


def test_an_alias_may_be_used() -> None:
    assert parse_yaml('a: &s [1, 2]\nb: *s\nc: {<<: {d: 1}}\n', 'x')['b'] == [1, 2]


def test_what_is_merged_in_may_be_replaced() -> None:
    text = 'a: &a {x: 1, y: 2}\nb: &b {<<: *a, y: 3}\nc: {<<: *b, x: 4, 1: 5, "1": 6}\n'
    assert parse_yaml(text, 'x') == {
        'a': {'x': 1, 'y': 2},
        'b': {'x': 1, 'y': 3},
        'c': {'x': 4, 'y': 3, 1: 5, '1': 6},
    }


@pytest.mark.parametrize(
    ('text', 'why'),
    [
        (_LAUGHS, 'more than 300000 values'),
        ('a: &a [*a]\n', 'contains itself'),
        ('[' * 5000 + ']' * 5000, f'nested more than {MOST_NESTED} deep'),
        ('a: ' + '1' * 5001, 'thousands of digits'),
        ('a: 0x' + 'f' * 5001, 'is too large'),
        ('a: 2026-02-31T00:00:00Z', 'not YAML'),
        ('a: [1, 2', 'not YAML'),
        ('a: 1\nb: {c: 1\nd: 2}\n', r'not YAML: line 3, column 2: .* parsing .* of line 2$'),
        ('a:\n\t- 1\n', 'not YAML: line 2, column 1: .*; a tab stands there'),
        ('a: !!python/object/apply:os.getcwd []', 'could not determine a constructor'),
        ('a: \x00', 'not YAML'),
        ('a: 1\nb: {c: 1,\n d: 2, c: 3}\n', "key 'c' stands there twice, again in line 3"),
        ('imu: {}\ndvl: {}\nimu: {}\n', "key 'imu' stands there twice, again in line 3"),
        ('? [a, b]\n: 1\n? {c: d}\n: 2\n', 'not YAML'),
    ],
)
def test_is_refused_by_a_sentence(text: str, why: str) -> None:
    with pytest.raises(ConfigError, match=r'^mission\.yaml: .*' + why):
        parse_yaml(text, 'mission.yaml')


def test_only_regular_files(tmp_path: Path) -> None:
    pipe = tmp_path / 'pipe.yaml'
    os.mkfifo(pipe)
    with pytest.raises(ConfigError, match=r'pipe\.yaml is a pipe'):
        read_yaml(pipe)
    with pytest.raises(ConfigError, match='is a device'):
        regular(Path('/dev/zero'))


def test_files_that_are_no_text(tmp_path: Path) -> None:
    (tmp_path / 'latin.yaml').write_bytes(b'a: \xe9\n')
    with pytest.raises(ConfigError, match=r'latin\.yaml: not UTF-8'):
        read_yaml(tmp_path / 'latin.yaml')
    (tmp_path / 'large.yaml').write_bytes(b'a' * 101)
    with pytest.raises(ConfigError, match=r'large\.yaml is larger than 100 bytes'):
        read_text(tmp_path / 'large.yaml', most_bytes=100)
    with pytest.raises(ConfigError, match=r'none\.yaml: No such file'):
        read_yaml(tmp_path / 'none.yaml')
    with pytest.raises(ConfigError, match='Is a directory'):
        read_yaml(tmp_path)
