"""Errors of this package."""

from __future__ import annotations

from collections.abc import Collection

from polar_nav_core.errors import ConfigError, PolarNavError


class BagError(PolarNavError):
    """A bag cannot be written or read as requested: one sentence that names the file."""


class WrongRequestError(BagError, ConfigError):
    """A bag or vehicle was named that is not there, or a bag that is there was to be written."""


_MOST_NAMES = 12


def some_of(names: Collection[str]) -> str:
    """Names for a sentence: all of a few, the first of many."""
    shown = ', '.join(sorted(names)[:_MOST_NAMES])
    return f'{shown}, ...' if len(names) > _MOST_NAMES else shown
