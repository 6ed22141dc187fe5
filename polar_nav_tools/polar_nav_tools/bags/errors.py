"""The one error of this package."""

from __future__ import annotations

from polar_nav_core.errors import PolarNavError


class BagError(PolarNavError):
    """A bag cannot be written or read as requested: one sentence that names the file."""
