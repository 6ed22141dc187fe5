"""Errors that a user is meant to read: one sentence naming the parameter, file, topic or place."""

from __future__ import annotations


class PolarNavError(Exception):
    """Base of all errors whose text explains everything: a command prints it, no traceback."""


class ConfigError(PolarNavError):
    """A parameter or a configuration file cannot be used."""


class FilterDivergence(PolarNavError):
    """A covariance lost definiteness or a state is not finite.

    No estimate may be published any more.
    """
