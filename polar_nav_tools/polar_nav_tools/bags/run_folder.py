"""Files of a live run in the folder of its bag: logs, parameters, outcome."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from .errors import BagError

RUN_FOLDER, OUTCOME_NAME = 'run', 'outcome.json'


def read_outcome(bag: Path) -> dict[str, Any]:
    """Outcome of a live run, from the folder of its bag; empty for bags of other origin."""
    path = bag / RUN_FOLDER / OUTCOME_NAME
    if not bag.is_dir() or not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except (ValueError, RecursionError) as error:
        raise BagError(f'{path}: not JSON: {error}') from error
    return content if isinstance(content, dict) else {}
