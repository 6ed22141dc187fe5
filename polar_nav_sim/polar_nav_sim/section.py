"""One section of a mission file or a parameter set: a dataclass that checks itself."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import check, from_mapping

T = TypeVar('T')


@dataclass(frozen=True)
class Spec:
    """Base: every section checks itself."""

    def __post_init__(self) -> None:
        check(self)


def parse(cls: type[T], values: object, where: str) -> T:
    """One section from its mapping in a file; whole numbers may stand for floats.

    Raises
    ------
    ConfigError
        Naming the file, the section and the key.
    """
    if not isinstance(values, Mapping):
        raise ConfigError(f'{where}: expected a mapping, found {reprlib.repr(values)}')
    kinds = {f.name: f.metadata.get('kind') for f in fields(cls)}  # type: ignore[arg-type]
    try:
        return from_mapping(cls, {str(k): _typed(v, kinds.get(str(k))) for k, v in values.items()})
    except ConfigError as error:
        raise ConfigError(f'{where}: {error}') from error


def _typed(value: Any, kind: str | None) -> Any:  # noqa: ANN401 - a value of a YAML file
    if kind == 'float' and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if kind == 'floats' and isinstance(value, list | tuple):
        return [float(v) if isinstance(v, int | float) else math.nan for v in value]
    if kind == 'str' and not isinstance(value, str) and value is not None:
        return str(value)
    return value
