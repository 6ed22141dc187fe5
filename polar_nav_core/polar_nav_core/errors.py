"""Errors that a user is meant to read: one sentence that names the parameter, file, topic or place."""

from __future__ import annotations


class PolarNavError(Exception):
    """Base of all errors whose text is the whole explanation; a command prints it without a traceback."""


class ConfigError(PolarNavError):
    """A parameter or a configuration file cannot be used."""


class FilterDivergence(PolarNavError):
    """A covariance lost definiteness or a state is not finite: no estimate may be published any more."""
