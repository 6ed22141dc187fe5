"""Version of the engine; it changes when the same inputs and parameters give other bits.

A node publishes it on ``/run_info``, a recorded run carries it, and a replay reads there whether
the recorded bytes are its own (compared bit for bit) or those of another engine (compared in units
of sigma). Bags of before it was stated were all recorded with version 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

ENGINE_VERSION = 27
"""Counts up whenever the same inputs and the same stated parameters give other bits.

So it does when a formula or the order of a sum changes, when a named configuration stands for
something else, or when a parameter gets another default (a file of parameters that leaves it out
gives other bits then). It does not when code only moves, when a parameter that had no effect is
retired, or when a new parameter's default leaves the bits as they were.
"""
DOF_STATED = 14
"""Engines before it wrote three degrees of freedom into the receipt of every position."""
_FIRST = 1
"""Of bags of before the version was stated."""


def engine_version_of(info: Mapping[str, Any]) -> int:
    """Engine version stated in a description or certificate; that of before it was, if none."""
    version = info.get('engine_version')
    if isinstance(version, int) and not isinstance(version, bool) and version >= _FIRST:
        return version
    return _FIRST
