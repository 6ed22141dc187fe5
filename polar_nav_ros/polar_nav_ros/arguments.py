"""Arguments after --ros-args that ROS 2 takes for nobody, in silence.

A parameter that is stated for a node by its name (`-p dvl_node:rate_hz:=5.0`), and a section of a
parameter file, are for the node of that full name: in a namespace they are not for the one meant.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import read_yaml

_FOR_ONE = re.compile(r'([A-Za-z]\w*):([^:=]+):=')
_NAMESPACE = re.compile(r'(?:[A-Za-z]\w*:)?__ns:=(/.+)')
_WILD = {'/**': r'(?:/\w+)*', '/*': r'/\w+'}


def require_reached(arguments: Sequence[str]) -> None:
    """Refuse a parameter for one node, by its name, where nodes are in a namespace.

    Raises
    ------
    ConfigError
        Saying how it is stated.
    """
    namespaces = [m[1] for v in _values(arguments, '-r', '--remap') if (m := _NAMESPACE.match(v))]
    for rule in _values(arguments, '-p', '--param'):
        stated = _FOR_ONE.match(rule)
        if stated and namespaces:
            raise ConfigError(
                f'-p {rule}: ROS 2 takes it for the node /{stated[1]}, in no namespace, alone: '
                f'state it in a --params-file, under {namespaces[0]}/{stated[1]}:'
            )


def unread(arguments: Sequence[str], names: Sequence[str]) -> list[str]:
    """Sentences on parameter files without a section for any of these nodes, by full names."""
    found = []
    for file in _values(arguments, '--params-file'):
        try:
            sections = list(_sections(read_yaml(Path(file))))
        except ConfigError:  # ROS has read it
            continue
        if sections and not any(_is_for(s, name) for s in sections for name in names):
            found.append(
                f'{file} states nothing for {", ".join(names)}: its sections are '
                f'{", ".join(sections)} (`/**:` is for any node)'
            )
    return found


def _values(arguments: Sequence[str], *flags: str) -> Iterator[str]:
    """Values of a flag among the arguments for ROS."""
    start = arguments.index('--ros-args') if '--ros-args' in arguments else len(arguments)
    return (value for flag, value in pairwise(arguments[start:]) if flag in flags)


def _sections(content: object, above: str = '') -> Iterator[str]:
    """Names of nodes, with wildcards, in a parameter file."""
    if not isinstance(content, Mapping):
        return
    for key, value in content.items():
        if key == 'ros__parameters':
            yield above
        else:
            yield from _sections(value, f'{above}/{str(key).strip("/")}')


def _is_for(section: str, name: str) -> bool:
    """Whether a section is for a node, as rcl matches it."""
    pattern = re.sub(r'/\*\*|/\*|[^/*]+|.', lambda m: _WILD.get(m[0], re.escape(m[0])), section)
    return re.fullmatch(pattern, name) is not None
