"""Metadata records and keys that describe a run: who writes them and who reads them agree here."""

from __future__ import annotations

import json
from typing import Any

from .contents import FileScan

RUN_RECORD = 'polar_nav_run'
RUN_END_RECORD = 'polar_nav_run_end'
"""Name of the metadata records that describe the run."""
PHASE_KEY = 'written'
"""Key in those records: ``start`` or ``end``."""
RECOVERY_RECORD = 'polar_nav_recovery'
"""Name of the metadata record of `recover`: the bag was once broken."""
INJECTED_KEY = 'injected'
"""Key of the run's description with what `polar inject` has changed."""


def run_records(file: FileScan) -> list[tuple[str, dict[str, str]]]:
    """Metadata records of start and end, in order; older bags have one name for both."""
    return [(name, m) for name, m in file.metadata if name in (RUN_RECORD, RUN_END_RECORD)]


def json_or_none(text: str) -> Any:  # noqa: ANN401 - any value of the JSON
    """Value of a JSON text; None for another text."""
    try:
        return json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return None
