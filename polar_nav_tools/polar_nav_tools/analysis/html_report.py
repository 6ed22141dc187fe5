"""Writes the report of an analysis as one HTML file."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from ..report import write_report
from .analyse import Analysis
from .report_input import report_input


def write_analysis(analysis: Analysis, path: Path) -> Path:
    """Path of the HTML report of an analysis, after writing it."""
    made = f'{datetime.now(UTC):%Y-%m-%d %H:%M} UTC by polar_nav_tools {_version()}'
    source = report_input(analysis, title=analysis.bag.path.name, made=made)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_report(path, source)
    return path


def _version() -> str:
    try:
        return metadata.version('polar_nav_tools')
    except metadata.PackageNotFoundError:
        return 'from sources'
