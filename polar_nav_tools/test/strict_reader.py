"""A strict checker of MCAP files by others: `pymcap-cli doctor`, pinned in requirements.lock."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest


def strict_complaints(path: Path) -> list[str]:
    """Errors and warnings on an .mcap file; skips the test where the checker is not installed."""
    program = shutil.which('pymcap-cli')
    if program is None:
        pytest.skip('no pymcap-cli: it is not in this environment')
    done = subprocess.run(
        [program, 'doctor', '--format', 'jsonl', str(path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120.0,
    )
    found = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{')]
    assert found, done.stderr
    levels = ('error', 'warning')
    return [json.dumps(f) for f in found if str(f.get('severity', '')).lower() in levels]
