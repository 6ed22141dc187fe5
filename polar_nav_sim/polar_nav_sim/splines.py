"""Functions of scipy.interpolate, loaded by the first that is used.

Only what makes a trajectory needs them; the nodes that listen to it, most of a graph, start half a
second of processor time earlier without.
"""

from __future__ import annotations

from typing import Any


def __getattr__(name: str) -> Any:  # noqa: ANN401 - of scipy.interpolate
    from scipy import interpolate

    return getattr(interpolate, name)
