"""Message packages that a bag describes and this computer lacks, checked before anything is built.

Definitions in a bag are untrusted. Only names, types, sizes and numbers that pass the rules here
are written into new .msg files: no comment, no text, no default of the bag.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ..bags.decode import Fields, fields_of, store_of
from ..bags.errors import BagError
from ..bags.schemas import definition

MOST_PACKAGES, MOST_TYPES, MOST_FIELDS, MOST_CONSTANTS = 16, 100, 200, 200
MOST_BYTES = 1 << 20
"""Size of a message in memory without its sequences and strings; generated code allocates it."""
_MOST_DEPTH = 16
_PACKAGE = re.compile(r'(?!.*__)[a-z][a-z0-9_]*[a-z0-9]')
_TYPE = re.compile(r'[A-Z][A-Za-z0-9]*')
_FIELD = re.compile(r'(?!.*__)[a-z](?:[a-z0-9_]*[a-z0-9])?')
_CONSTANT = re.compile(r'(?!.*__)[A-Z](?:[A-Z0-9_]*[A-Z0-9])?')
_LONGEST_NAME = 64
_SIZES = {
    'bool': 1, 'byte': 1, 'char': 1, 'int8': 1, 'uint8': 1, 'int16': 2, 'uint16': 2, 'int32': 4,
    'uint32': 4, 'float32': 4, 'int64': 8, 'uint64': 8, 'float64': 8, 'string': 24,
}  # fmt: skip
_SEQUENCE_SIZE = 24


@dataclass
class Recipe:
    """A package to build.

    Attributes
    ----------
    package : str
    files : dict of str to str
        Content of each NAME.msg, written here from validated parts, by NAME.
    needs : set of str
        Packages whose types it uses; those of the plan stand before it.
    """

    package: str
    files: dict[str, str] = field(default_factory=dict)
    needs: set[str] = field(default_factory=set)


@dataclass
class Plan:
    """Which types can be published, and what has to be built for it.

    Attributes
    ----------
    recipes : list of Recipe
        In the order in which they are built.
    used : dict of str to set of str
        Packages to build for each type of a topic; none for a type that is installed.
    refused : dict of str to str
        Reason by type.
    """

    recipes: list[Recipe] = field(default_factory=list)
    used: dict[str, set[str]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


def plan(texts: Mapping[str, str], has_package: Callable[[str], bool]) -> Plan:
    """Return how to come by the types of some topics.

    Parameters
    ----------
    texts : mapping of str to str
        ros2msg definition by type, as in the bag.
    has_package : callable
        Whether a package of this name is here: it is never built again.
    """
    result = Plan()
    recipes: dict[str, Recipe] = {}
    for type_name, text in texts.items():
        trial = {name: Recipe(name, dict(r.files), set(r.needs)) for name, r in recipes.items()}
        try:
            result.used[type_name] = _add(type_name, text, has_package, trial)
            ordered = _ordered(trial)
            _check_size(trial)
        except BagError as error:
            result.refused[type_name] = str(error)
            result.used.pop(type_name, None)
            continue
        recipes, result.recipes = trial, ordered
    return result


def _add(
    type_name: str, text: str, has_package: Callable[[str], bool], recipes: dict[str, Recipe]
) -> set[str]:
    """Add what a type needs to the recipes; returns the names of these."""
    if type_name.count('/') != 2 or type_name.split('/')[1] != 'msg':
        raise BagError(f'{type_name} is no message type')
    store = store_of(text, type_name)
    needed = set()
    for name in _closure(store, type_name):
        package, _, short = name.split('/')
        if has_package(package):
            _check_installed(store, name)
            continue
        content = message_text(store, name)
        recipe = recipes.setdefault(package, Recipe(package))
        if recipe.files.setdefault(short, content) != content:
            raise BagError(f'the bag defines {name} in two ways')
        recipe.needs |= {n.split('/')[0] for n in _parts_of(store, name)} - {package}
        needed.add(package)
    return needed


def _closure(store: Typestore, type_name: str) -> list[str]:
    """Types in use, the given one first, after checks of nesting and size."""
    found: dict[str, None] = {}
    _walk(store, type_name, (), found, {})
    return list(found)


def _walk(
    store: Typestore,
    name: str,
    above: tuple[str, ...],
    found: dict[str, None],
    sizes: dict[str, int],
) -> int:
    """Size in memory of a type, without what its sequences and strings point to."""
    if name in above:
        raise BagError(f'{name} contains itself')
    if len(above) > _MOST_DEPTH:
        raise BagError(f'{above[0]} is nested more than {_MOST_DEPTH} deep')
    if name in sizes:
        return sizes[name]
    found[name] = None
    if len(found) > MOST_TYPES:
        raise BagError(f'{above[0]} uses more than {MOST_TYPES} types')
    total = 0
    for _, (kind, what) in fields_of(store, name):
        inner_kind, inner = (kind, what) if kind <= Nodetype.NAME else what[0]
        if inner_kind == Nodetype.NAME:
            size = _walk(store, inner, (*above, name), found, sizes)
        else:
            size = _SIZES.get(inner[0], 8)
        if kind == Nodetype.ARRAY:
            size *= max(1, int(what[1]))
        total += _SEQUENCE_SIZE if kind == Nodetype.SEQUENCE else size
    if total > MOST_BYTES:
        raise BagError(f'{name} has {total} bytes without its sequences; {MOST_BYTES} are allowed')
    sizes[name] = total
    return total


def _check_installed(store: Typestore, name: str) -> None:
    """Raise BagError unless an installed type has the fields that the bag describes."""
    package = name.split('/')[0]
    try:
        own = store_of(definition(name).text, name)
    except BagError as error:
        raise BagError(
            f'package {package} is installed here, but it has no {name} ({error})'
        ) from error
    if fields_of(own, name) != fields_of(store, name):
        raise BagError(f'{name} has other fields in the bag than in the {package} installed here')


def message_text(store: Typestore, name: str) -> str:
    """Return a .msg file with the fields and numeric constants of a type.

    Raises
    ------
    BagError
        If a name or number is outside of what ROS allows.
    """
    package, middle, short = name.split('/')
    _check_name(_PACKAGE, package, f'package of {name}')
    _check_name(_TYPE, short, f'name of {name}')
    if middle != 'msg':
        raise BagError(f'{name} is no name of a message')
    constants, fields = store.fielddefs[name][:2]
    if len(fields) > MOST_FIELDS or len(constants) > MOST_CONSTANTS:
        raise BagError(f'{name} has more than {MOST_FIELDS} fields or constants')
    lines = [text for text in (_constant(name, *c) for c in constants) if text]
    for field_name, (kind, what) in fields:
        _check_name(_FIELD, field_name, f'field of {name}')
        lines.append(f'{_field_type(name, kind, what)} {field_name}')
    return '\n'.join(lines) + '\n'


def _field_type(name: str, kind: int, what: Any) -> str:  # noqa: ANN401 - rosbags' notation
    if kind == Nodetype.NAME:
        package, _, short = what.split('/')
        _check_name(_PACKAGE, package, f'package in {name}')
        _check_name(_TYPE, short, f'type in {name}')
        return f'{package}/{short}'
    if kind == Nodetype.BASE:
        base, limit = what
        if base not in _SIZES:
            raise BagError(f'{name}: type {base} cannot be built')
        return f'{base}<={int(limit)}' if limit else str(base)
    (inner_kind, inner), count = what
    if inner_kind not in (Nodetype.NAME, Nodetype.BASE):
        raise BagError(f'{name}: arrays of arrays cannot be built')
    element = _field_type(name, inner_kind, inner)
    count = int(count)
    if count < 0 or (kind == Nodetype.ARRAY and count == 0):
        raise BagError(f'{name}: an array of {count}')
    if kind == Nodetype.ARRAY:
        return f'{element}[{count}]'
    return f'{element}[<={count}]' if count else f'{element}[]'


def _constant(type_name: str, name: str, base: str, value: object) -> str:
    """Line of a constant, empty for one that is no number: texts are not taken over."""
    _check_name(_CONSTANT, name, f'constant of {type_name}')
    if base == 'bool' and isinstance(value, bool):
        return f'bool {name}={"true" if value else "false"}'
    if base in ('float32', 'float64') and isinstance(value, int | float) and math.isfinite(value):
        return f'{base} {name}={float(value)!r}'
    if base in _SIZES and 'int' in base and isinstance(value, int):
        bits = 8 * _SIZES[base]
        low, high = (0, 1 << bits) if base[0] == 'u' else (-1 << (bits - 1), 1 << (bits - 1))
        if not low <= value < high:
            raise BagError(f'{type_name}: {name} is outside of {base}')
        return f'{base} {name}={int(value)}'
    return ''


def _check_name(pattern: re.Pattern[str], name: str, what: str) -> None:
    if len(name) > _LONGEST_NAME or not pattern.fullmatch(name):
        raise BagError(f'{what}: {name[:_LONGEST_NAME]!r} is not allowed')


def _parts_of(store: Typestore, name: str) -> set[str]:
    fields: Fields = fields_of(store, name)
    found = set()
    for _, (kind, what) in fields:
        inner_kind, inner = (kind, what) if kind <= Nodetype.NAME else what[0]
        if inner_kind == Nodetype.NAME:
            found.add(inner)
    return found


def _check_size(recipes: Mapping[str, Recipe]) -> None:
    if len(recipes) > MOST_PACKAGES:
        raise BagError(f'the bag needs more than {MOST_PACKAGES} packages built')
    if sum(len(r.files) for r in recipes.values()) > MOST_TYPES:
        raise BagError(f'the bag needs more than {MOST_TYPES} types built')


def _ordered(recipes: Mapping[str, Recipe]) -> list[Recipe]:
    """Recipes in the order of their needs."""
    done: list[Recipe] = []
    waiting = dict(sorted(recipes.items()))
    while waiting:
        ready = [n for n, r in waiting.items() if not r.needs & waiting.keys()]
        if not ready:
            raise BagError(f'packages {", ".join(waiting)} need one another')
        done += [waiting.pop(name) for name in ready]
    return done
