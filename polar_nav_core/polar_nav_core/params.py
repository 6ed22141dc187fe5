"""Parameters of nodes and filters: default, unit, range and text of each stand together, once.

A node declares the dataclass (polar_nav_ros.parameters), YAML files and documentation
read the same object, and :func:`check` refuses what is out of range with a sentence that names it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from difflib import SequenceMatcher
from typing import Any, TypeVar

from .errors import ConfigError
from .retired import RETIRED

T = TypeVar('T')

_FEW = 12
_SUGGESTED = 3
_FARTHEST = 0.3
"""Share of letters in which a name may differ from the one that was probably meant."""
_NEARLY = 1.5
"""How much further than the nearest name another one may be."""


def param(default: float, unit: str, lo: float, hi: float, doc: str) -> Any:  # noqa: ANN401 - a dataclass field
    """Number in [lo, hi]; an int default makes an int parameter."""
    kind = 'int' if isinstance(default, int) and not isinstance(default, bool) else 'float'
    return field(
        default=default, metadata={'kind': kind, 'unit': unit, 'lo': lo, 'hi': hi, 'doc': doc}
    )


def sigma(default: float, unit: str, hi: float, doc: str) -> Any:  # noqa: ANN401
    """Standard deviation in [0, hi]; 0 stands for none."""
    return param(default, unit, 0.0, hi, doc)


def vector(default: Sequence[float], unit: str, lo: float, hi: float, doc: str) -> Any:  # noqa: ANN401
    """List of floats of fixed length, each in [lo, hi]."""
    values = tuple(float(v) for v in default)
    meta = {'kind': 'floats', 'unit': unit, 'lo': lo, 'hi': hi, 'doc': doc, 'length': len(values)}
    return field(default=values, metadata=meta)


def choice(default: str, options: Sequence[str], doc: str) -> Any:  # noqa: ANN401
    """One of a few words."""
    return field(
        default=default,
        metadata={'kind': 'str', 'unit': '', 'options': tuple(options), 'doc': doc},
    )


def text(default: str, doc: str) -> Any:  # noqa: ANN401
    """Any text."""
    return field(default=default, metadata={'kind': 'str', 'unit': '', 'doc': doc})


def texts(default: Sequence[str], doc: str) -> Any:  # noqa: ANN401
    """List of texts."""
    return field(default=tuple(default), metadata={'kind': 'strs', 'unit': '', 'doc': doc})


def flag(default: bool, doc: str) -> Any:  # noqa: ANN401
    """Yes or no."""
    return field(default=default, metadata={'kind': 'bool', 'unit': '', 'doc': doc})


@dataclass(frozen=True)
class NodeParams:
    """Base of every node's parameters."""

    lockstep: bool = flag(
        False, 'Acknowledge every message to truth_node, which then loses nothing'
    )
    presence: bool = flag(
        False, 'Acknowledge five times a second, so that truth_node can wait for the whole graph'
    )

    def __post_init__(self) -> None:
        check(self)


def check(params: object) -> None:
    """Refuse values of the wrong type or out of range.

    Raises
    ------
    ConfigError
        Naming the parameter, its value and the limit.
    """
    for f in fields(params):  # type: ignore[arg-type]
        _check_one(f, getattr(params, f.name))


def _check_one(f: Field[Any], value: Any) -> None:  # noqa: ANN401 - value of any parameter
    kind = f.metadata.get('kind')
    if kind == 'float':
        if isinstance(value, bool) or not isinstance(value, float):
            raise ConfigError(f'parameter {f.name}: {value!r} is not a float (write 5.0, not 5)')
        _check_range(f, f.name, value)
    elif kind == 'int':
        if isinstance(value, bool) or not isinstance(value, int):
            raise ConfigError(f'parameter {f.name}: {value!r} is not an integer')
        _check_range(f, f.name, value)
    elif kind == 'floats':
        length = f.metadata['length']
        if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != length:
            raise ConfigError(f'parameter {f.name}: {value!r} is not a list of {length} floats')
        for i, v in enumerate(value):
            _check_range(f, f'{f.name}[{i}]', v)
    elif kind == 'str':
        options = f.metadata.get('options')
        if not isinstance(value, str):
            raise ConfigError(f'parameter {f.name}: {value!r} is not a text')
        if options is not None and value not in options:
            raise ConfigError(f'parameter {f.name}: {value!r} is none of {", ".join(options)}')
    elif kind == 'strs':
        if isinstance(value, str) or not all(isinstance(v, str) for v in value):
            raise ConfigError(f'parameter {f.name}: {value!r} is not a list of texts')
    elif kind == 'bool' and not isinstance(value, bool):
        raise ConfigError(f'parameter {f.name}: {value!r} is neither true nor false')


def _check_range(f: Field[Any], name: str, value: float) -> None:
    lo, hi, unit = f.metadata['lo'], f.metadata['hi'], f.metadata['unit']
    if not (math.isfinite(value) and lo <= value <= hi):
        raise ConfigError(f'parameter {name}: {value} is outside of [{lo}, {hi}] {unit}'.rstrip())


def from_mapping(cls: type[T], values: Mapping[str, Any]) -> T:
    """Build a parameter dataclass from a mapping; missing names take their default.

    Raises
    ------
    ConfigError
        For a name that the class does not have, or a value that :func:`check` refuses.
    """
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise ConfigError(unknown_parameter(unknown[0], cls.__name__, known))
    typed = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
    return cls(**typed)


def unknown_parameter(name: str, owner: str, known: Collection[str]) -> str:
    """Return why an owner has no parameter of that name: retired, or which ones are near."""
    if name in RETIRED:
        return f'parameter {name} of {owner} was {RETIRED[name]}'
    return f'unknown parameter {name} of {owner}; {names_near(name, known)}'


def names_near(name: str, known: Collection[str]) -> str:
    """Names closest to a misspelt one, as a sentence; all names if they are few."""
    if len(known) <= _FEW:
        return f'there are {", ".join(sorted(known))}'
    return f'{meant(name, known)}docs/parameters.md lists all {len(known)}'


def meant(name: str, known: Collection[str]) -> str:
    """Question with the names closest to a misspelt one, and a space; empty if none is near."""
    near = [k for k in sorted(known) if name in k] or _spelled_alike(name, known)
    return f'did you mean {" or ".join(near[:_SUGGESTED])}? ' if near else ''


def _spelled_alike(name: str, known: Collection[str]) -> list[str]:
    """Names that are nearly as near as the nearest, that one first; the order of words is free."""
    apart = {k: 1.0 - max(_ratio(name, k), _ratio(_words(name), _words(k))) for k in known}
    limit = min(_FARTHEST, _NEARLY * min(apart.values()))
    return sorted((k for k in apart if apart[k] <= limit), key=lambda k: (apart[k], k))


def _ratio(a: str, b: str) -> float:
    return SequenceMatcher(None, a, b, autojunk=False).ratio()


def _words(name: str) -> str:
    return '_'.join(sorted(name.split('_')))


def to_mapping(params: object) -> dict[str, Any]:
    """Turn the parameters into plain values that JSON and YAML can hold."""
    values = dataclasses.asdict(params)  # type: ignore[call-overload]
    return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}


def default_of(cls: type[Any], name: str) -> Any:  # noqa: ANN401 - the default of any parameter
    """Return the default of one parameter."""
    f = next(f for f in fields(cls) if f.name == name)
    if f.default is MISSING:
        raise ConfigError(f'parameter {name} of {cls.__name__} has no default')
    return f.default
