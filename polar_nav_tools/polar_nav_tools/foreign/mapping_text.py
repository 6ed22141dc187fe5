"""Text of mapping files: read with comments, keys set with a comment of where they are from."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

_DECIMALS, _DIGITS = 6, 4
"""Of a number: so many decimals, but digits of a small one, as noise densities are."""
_INDENTS = (2, 4)
"""Of sections, and of those in a list."""


@dataclass(frozen=True)
class Written:
    """What a command found, as text.

    Attributes
    ----------
    text : str
        The new mapping file, or lines of ``parameters:``.
    names : tuple of str
        What is in it.
    left : mapping of str to str
        What was found and is not in it, and why.
    """

    text: str
    names: tuple[str, ...]
    left: Mapping[str, str]


def sections(top: CommentedMap, key: str) -> list[CommentedMap]:
    """Sections of a key: one, or those of a list."""
    found = top[key]
    return list(found) if isinstance(found, CommentedSeq | list) else [found]


def parameters_of(top: CommentedMap) -> CommentedMap:
    """Section ``parameters``, made where there is none."""
    if top.get('parameters') is None:
        top['parameters'] = CommentedMap()
    section: CommentedMap = top['parameters']
    return section


def put(section: CommentedMap, key: str, value: Any, origin: str) -> None:  # noqa: ANN401
    """Set a key, with a line above it that says where the value is from."""
    section.fa.set_block_style()  # a line of its own for the comment
    section[key] = _plain(value)
    column = section.lc.col
    section.yaml_set_comment_before_after_key(
        key, before=origin, indent=column if column in _INDENTS else _INDENTS[0]
    )


def _plain(value: Any) -> Any:  # noqa: ANN401
    """Value rounded, lists and maps on one line."""
    if isinstance(value, float):
        small = 0.0 < abs(value) < 10.0 ** (_DIGITS - _DECIMALS)
        return float(f'{value:.{_DIGITS}g}') if small else round(value, _DECIMALS) + 0.0
    if isinstance(value, list):
        row = CommentedSeq([_plain(v) for v in value])
        row.fa.set_flow_style()
        return row
    if isinstance(value, dict):
        table = CommentedMap({k: _plain(v) for k, v in value.items()})
        table.fa.set_flow_style()
        return table
    return value


def load_text(text: str) -> CommentedMap:
    """Mapping file with its comments."""
    top: CommentedMap = _yaml().load(text)
    return top


def text_of(top: CommentedMap) -> str:
    """Text of a mapping file."""
    out = io.StringIO()
    _yaml().dump(top, out)
    return out.getvalue()


def _yaml() -> YAML:
    yaml = YAML()
    yaml.preserve_quotes = True
    yaml.width = 4096
    yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml
