"""Processor time and memory of other processes, as Linux counts them."""

from __future__ import annotations

import os
from pathlib import Path


def cpu_s(pid: int) -> float:
    """Processor time of a process so far [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def resident_mb(pid: int) -> float:
    """Resident memory of a process [MB]; what it shares with others is counted in each."""
    pages = int(Path(f'/proc/{pid}/statm').read_text(encoding='ascii').split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def proportional_mb(pid: int) -> float:
    """Memory of a process [MB], of what it shares its part: sums of it count nothing twice."""
    return _rollup_mb(pid, 'Pss')


def own_mb(pid: int) -> float:
    """Memory of a process that no file stands behind [MB]: what it has allocated and written.

    Unlike its part of shared libraries it does not change when other programs begin or end.
    """
    return _rollup_mb(pid, 'Anonymous')


def _rollup_mb(pid: int, wanted: str) -> float:
    for line in Path(f'/proc/{pid}/smaps_rollup').read_text(encoding='ascii').splitlines():
        name, _, value = line.partition(':')
        if name == wanted:
            return int(value.split()[0]) * 1024 / 1e6
    raise OSError(f'the kernel states no {wanted} of process {pid}')
