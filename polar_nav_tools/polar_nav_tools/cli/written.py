"""Copies of a mapping file that a command writes: their name, their JSON, and what is said."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from polar_nav_core.errors import ConfigError

from .app import say

if TYPE_CHECKING:
    from ..foreign.mapping_text import Written


def copy_of(mapping: Path | None, word: str) -> Path | None:
    """Path of the copy, MAPPING_word.yaml; None without a mapping.

    Raises
    ------
    ConfigError
        When it exists.
    """
    if mapping is None:
        return None
    target = mapping.with_name(f'{mapping.stem}_{word}{mapping.suffix}')
    if target.exists():
        raise ConfigError(f'{target} exists already; nothing is overwritten')
    return target


def written_values(written: Written | None, target: Path | None, kind: str) -> dict[str, object]:
    """JSON of what was written; ``kind`` names what its entries are."""
    if written is None:
        return {}
    return {
        'written': {
            'path': None if target is None or not written.names else str(target),
            'text': written.text,
            kind: list(written.names),
            'left': dict(written.left),
        }
    }


def write_copy(written: Written, target: Path | None, nothing: str, *, quiet: bool) -> None:
    """Write the copy, or print the lines where there is no mapping; ``nothing`` is why not."""
    for name, why in written.left.items():
        say(f'{name} is not written: {why}')
    if not written.names:
        say(f'nothing was written: {nothing}')
    elif target is not None:
        target.write_text(written.text, encoding='utf-8')
        say(f'{target}: {", ".join(written.names)}')
    elif not quiet:
        sys.stdout.write(written.text)
