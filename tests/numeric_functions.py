"""Every function that computes on the way to an estimate, found in the sources.

    python tests/numeric_functions.py        # each with the places that use it

Certificates promise estimates to 1e-6 sigma on any processor (docs/trust.md). What may differ
there by a last bit is not our own code, but what it calls: ``numeric_functions.yaml`` lists that,
and ``test_numeric_functions.py`` holds the list against what this finds.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import yaml

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_name('numeric_functions.yaml')
PACKAGES = ('polar_nav_core', 'polar_nav_follower', 'polar_nav_leader', 'polar_nav_ros')
"""What estimates are made by; the simulation makes other inputs, and the tools look at results."""
STANDARD = ('cmath', 'decimal', 'fractions', 'math', 'random', 'statistics')
"""Modules of Python that compute."""
NO_NUMBERS = re.compile(
    r'polar_nav_|rcl|rosidl|launch|\w+_(msgs|interfaces|srvs)$|(numba|llvmlite|yaml|ament_\w+)$'
)
"""Modules of others that do not; of all the rest every function counts."""
BUILTINS = ('complex', 'pow', 'round', 'sum')
METHODS = ('cumprod', 'cumsum', 'dot', 'mean', 'prod', 'std', 'sum', 'trace', 'var')
"""Methods of arrays that add or multiply."""
OPERATORS = {ast.MatMult: '@', ast.Pow: '**'}
IN_KERNELS = {**OPERATORS, ast.Mod: '%', ast.FloorDiv: '//'}
Found: TypeAlias = dict[str, list[str]]
"""Places (``file:line``) by the name of what they use."""


class Finder:
    """Finds what a file computes with.

    Parameters
    ----------
    tree : ast.Module
        Its syntax.
    """

    def __init__(self, tree: ast.Module) -> None:
        self._tree = tree
        self._names: dict[str, str] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    whole = alias.name if alias.asname else alias.name.partition('.')[0]
                    self._add(alias.asname or whole, whole, alias.name)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    self._add(
                        alias.asname or alias.name, f'{node.module}.{alias.name}', node.module
                    )

    def _add(self, name: str, whole: str, module: str) -> None:
        root = module.partition('.')[0]
        if root in STANDARD or not (root in sys.stdlib_module_names or NO_NUMBERS.match(root)):
            self._names[name] = whole

    def found(self) -> Iterator[tuple[str, str, int]]:
        """Yield where, ``compiled`` or ``python``, what, and in which line."""
        kernels = [n for n in self._tree.body if isinstance(n, ast.FunctionDef) and _kernel(n)]
        compiled = {id(node) for f in kernels for part in f.body for node in ast.walk(part)}
        parts = {id(n.value) for n in ast.walk(self._tree) if isinstance(n, ast.Attribute)}
        for node in ast.walk(self._tree):
            in_kernel = id(node) in compiled
            for name in self._used(node, part=id(node) in parts, in_kernel=in_kernel):
                yield ('compiled' if in_kernel else 'python'), name, node.lineno

    def _used(self, node: Any, *, part: bool, in_kernel: bool) -> Iterator[str]:
        """Yield what a node itself uses: none as a rule, one at most."""
        if isinstance(node, ast.Name | ast.Attribute) and not part:
            whole = self._whole(node)
            if whole is not None and _computes(whole):
                yield whole
        if isinstance(node, ast.BinOp | ast.AugAssign):
            operator = (IN_KERNELS if in_kernel else OPERATORS).get(type(node.op))
            if operator is not None:
                yield operator
        if isinstance(node, ast.Call):
            called = node.func
            if isinstance(called, ast.Name) and called.id in BUILTINS:
                yield f'{called.id}()'
            elif self._is_method(called):
                yield f'.{called.attr}()'

    def _is_method(self, called: ast.expr) -> bool:
        named = isinstance(called, ast.Attribute) and called.attr in METHODS
        return named and self._whole(called) is None

    def _whole(self, node: ast.AST) -> str | None:
        """Return the full name of what is imported, or None: ``numpy.linalg.norm``."""
        if isinstance(node, ast.Name):
            return self._names.get(node.id)
        if isinstance(node, ast.Attribute):
            before = self._whole(node.value)
            return before and f'{before}.{node.attr}'
        return None


def _kernel(function: ast.FunctionDef) -> bool:
    names = {d.id for d in function.decorator_list if isinstance(d, ast.Name)}
    return bool(names & {'kernel', 'routine'})


@cache
def _computes(whole: str) -> bool:
    """Return whether a name is a function: no constant, no type of NumPy's real numbers."""
    module, value = whole.split('.'), None
    for k in range(len(module), 0, -1):
        try:
            value = import_module('.'.join(module[:k]))
        except ImportError:
            continue
        for name in module[k:]:
            value = getattr(value, name)
        break
    else:
        return True  # not installed here: better once too often
    if isinstance(value, type):
        of_numpy = module[0] == 'numpy' and 'complex' not in value.__name__
        return not (of_numpy or issubclass(value, Exception))
    return callable(value) and 'typing' not in module


def found_in(files: Mapping[str, str]) -> dict[str, Found]:
    """Return what the texts of these files compute with: ``compiled`` and ``python``."""
    out: dict[str, Found] = {'compiled': defaultdict(list), 'python': defaultdict(list)}
    for file, text in files.items():
        for where, name, line in Finder(ast.parse(text)).found():
            out[where][name].append(f'{file}:{line}')
    return out


def sources() -> dict[str, str]:
    """Return the texts of all files that estimates are made by."""
    paths = [p for name in PACKAGES for p in sorted((ROOT / name / name).rglob('*.py'))]
    return {p.relative_to(ROOT).as_posix(): p.read_text(encoding='utf-8') for p in paths}


def listed() -> dict[str, Any]:
    """Return the list: ``kinds``, and by name the kinds of what is ``compiled`` and ``python``."""
    return dict(yaml.safe_load(LIST.read_text(encoding='utf-8')))


def complaints(found: Mapping[str, Found], known: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each function that only one of sources and list has."""
    out = []
    for where, names in found.items():
        for name in sorted(names.keys() - known[where].keys()):
            out.append(
                f'{name} ({where}, {names[name][0]}) is not in {LIST.name}: say there of which '
                f'kind it is ({", ".join(known["kinds"])}), and if it is not exact, replay a bag '
                'as another processor would (docs/trust.md, "other processors")'
            )
        for name in sorted(known[where].keys() - names.keys()):
            out.append(f'{name} ({where}) is in {LIST.name}, and no source uses it: remove it')
    return out


def main() -> None:
    """Print each function with the places that use it."""
    for where, names in found_in(sources()).items():
        for name, places in sorted(names.items()):
            sys.stdout.write(f'{where}\t{name}\t{len(places)}\t{" ".join(places)}\n')


if __name__ == '__main__':
    main()
