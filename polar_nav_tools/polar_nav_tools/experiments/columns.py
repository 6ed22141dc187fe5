"""Filters compared in the tables, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from polar_nav_core.engine.methods import CONFIGURATIONS
from polar_nav_core.errors import ConfigError

from .choices import Choices

CLAIRVOYANT = 'clairvoyant'


@dataclass(frozen=True)
class FilterColumn:
    """One filter, a column of the tables.

    Attributes
    ----------
    name : str
        Name of the column.
    doc : str
        Description, one line.
    changes : dict
        Parameters of the engine.
    clairvoyant : bool
        Whether it gets each fix at its time of validity.
    """

    name: str
    doc: str
    changes: dict[str, Any] = field(default_factory=dict)
    clairvoyant: bool = False


def _custom(strategy: str, gate_probability: float) -> dict[str, Any]:
    return {
        'configuration': 'custom',
        'delay_handling': strategy,
        'noise_adaptation': 'none',
        'gate_probability': gate_probability,
    }


STRATEGIES = {
    'ignore': 'fuses late fixes as if current, stated noise',
    'tagged': 'compares a late fix with the stored state of its time, corrects the present one',
    'back_propagate': 'H Phi^-1 at the time of validity, stated noise',
    'clone': 'position at the time of validity kept as further states, stated noise: exact',
    'rewind': 'goes back to the time of validity and forward again, stated noise: exact',
}


def filter_columns(choices: Choices) -> dict[str, FilterColumn]:
    """All filters, by name."""
    out = {
        name: FilterColumn(name, configuration.doc, {'configuration': name})
        for name, configuration in CONFIGURATIONS.items()
    }
    gate = choices.gate_probability
    for strategy, doc in STRATEGIES.items():
        out[strategy] = FilterColumn(strategy, doc, _custom(strategy, gate))
    out[CLAIRVOYANT] = FilterColumn(
        CLAIRVOYANT,
        'receives each fix when it is valid, as without any delay; stated noise',
        _custom('ignore', gate),
        clairvoyant=True,
    )
    return out


def pick(choices: Choices, names: Sequence[str]) -> list[FilterColumn]:
    """Columns by name, in this order.

    Raises
    ------
    ConfigError
        For an unknown name.
    """
    known = filter_columns(choices)
    for name in names:
        if name not in known:
            raise ConfigError(f'--columns: no filter {name!r}; there are {", ".join(known)}')
    return [known[name] for name in names]


def present(names: Sequence[str]) -> list[str]:
    """Those of these names that are filters of this engine version."""
    known = {*CONFIGURATIONS, *STRATEGIES, CLAIRVOYANT}
    return [name for name in names if name in known]
