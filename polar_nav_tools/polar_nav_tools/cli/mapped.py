"""Opens a bag of any origin with its mapping file, for one command."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .app import say

if TYPE_CHECKING:
    from polar_nav_ros.adapters.mapping import Mapping as Sources

    from ..foreign.sources import Source


def open_mapped(
    path: Path, mapping_path: Path, changes: Mapping[str, Any], msg_path: Path | None = None
) -> tuple[Source, Sources]:
    """Open a bag of any kind, and read its mapping; states what is missing in the bag.

    The command ends with status 1 where the source has problems.
    """
    from polar_nav_ros.adapters import mapping, mapping_file

    from ..foreign.sources import open_source
    from ..terminal.progress import opening_display

    with opening_display(path) as progress:
        source = open_source(path, progress, msg_path=msg_path)
    for problem in source.problems:
        say(f'{path}: {problem}')
    return source, mapping.with_parameters(mapping_file.load(mapping_path), changes)
