"""Errors of this package."""

from __future__ import annotations

from polar_nav_core.errors import ConfigError, PolarNavError


class BagError(PolarNavError):
    """A bag cannot be written or read as requested: one sentence that names the file."""


class WrongRequestError(BagError, ConfigError):
    """A bag or vehicle was named that is not there, or a bag that is there was to be written."""
