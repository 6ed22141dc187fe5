"""One self-contained HTML report of a run: `write_report(path, ReportInput(...))`.

matplotlib and jinja2 are loaded with the first use of `write_report` or `render`, not with the
input classes: commands that only score need not wait for them.
"""

from typing import TYPE_CHECKING

from .input import (
    Digest,
    FixPositions,
    ReportInput,
    SentPackets,
    StationRanges,
    TopicCount,
)

if TYPE_CHECKING:
    from .write import render, write_report

__all__ = [
    'Digest',
    'FixPositions',
    'ReportInput',
    'SentPackets',
    'StationRanges',
    'TopicCount',
    'render',
    'write_report',
]


def __getattr__(name: str) -> object:
    if name in ('render', 'write_report'):
        from . import write

        return getattr(write, name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
