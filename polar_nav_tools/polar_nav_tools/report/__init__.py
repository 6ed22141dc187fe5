"""One self-contained HTML report of a run: `write_report(path, ReportInput(...))`.

matplotlib and jinja2 are loaded with this package, not with `polar_nav_tools.scoring`.
"""

from .input import Digest, FixPositions, ReportInput, SentPackets, TopicCount
from .write import render, write_report

__all__ = [
    'Digest',
    'FixPositions',
    'ReportInput',
    'SentPackets',
    'TopicCount',
    'render',
    'write_report',
]
