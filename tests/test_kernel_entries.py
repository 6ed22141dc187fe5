"""What Python calls of the compiled code is compiled for that, by the set-up, and nothing else is.

A kernel without `entry` that Python calls all the same would be compiled again, in a node that
is under way.
"""

import ast
from pathlib import Path
from typing import TypeAlias

ROOT = Path(__file__).parents[1]
Kernel: TypeAlias = tuple[Path, str]


def decorators_of(function: ast.FunctionDef) -> set[str]:
    return {d.id for d in function.decorator_list if isinstance(d, ast.Name)}


def trees() -> dict[Path, ast.Module]:
    """Syntax of each file of the packages, without their tests."""
    paths = sorted(ROOT.glob('polar_nav_*/polar_nav_*/**/*.py'))
    return {p: ast.parse(p.read_text(encoding='utf-8')) for p in paths}


def functions_of(tree: ast.Module) -> list[ast.FunctionDef]:
    return [n for n in tree.body if isinstance(n, ast.FunctionDef)]


def kernels_of(files: dict[Path, ast.Module]) -> dict[Kernel, set[str]]:
    """Each kernel with its decorators."""
    return {
        (path, f.name): decorators_of(f)
        for path, tree in files.items()
        if 'kernels' in path.parts
        for f in functions_of(tree)
        if decorators_of(f) & {'kernel', 'routine'}
    }


def place_of(path: Path, node: ast.ImportFrom) -> Path:
    """Module or package that an import names, as a path without suffix."""
    names = (node.module or '').split('.') if node.module else []
    if node.level:
        return path.parents[node.level - 1].joinpath(*names)
    return ROOT.joinpath(names[0], *names)


def kernels_named(path: Path, tree: ast.Module, kernels: dict[Kernel, set[str]]) -> set[Kernel]:
    """Kernels that the Python of a file names: all of it, but for kernels themselves."""
    modules: dict[str, Path] = {}
    names = {name: (p, name) for p, name in kernels if p == path}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            place = place_of(path, node)
            for alias in node.names:
                imported = (place.with_suffix('.py'), alias.name)
                if imported in kernels:
                    names[alias.asname or alias.name] = imported
                modules[alias.asname or alias.name] = (place / alias.name).with_suffix('.py')
    compiled = [f for f in functions_of(tree) if (path, f.name) in kernels]
    left_out = {id(node) for f in compiled for node in ast.walk(f)}
    found = set()
    for node in ast.walk(tree):
        if id(node) in left_out:
            continue
        if isinstance(node, ast.Name) and node.id in names:
            found.add(names[node.id])
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            found.add((modules.get(node.value.id, path), node.attr))
    return found & set(kernels)


def test_python_calls_entries_and_only_those_are():
    files = trees()
    kernels = kernels_of(files)
    called = set().union(*(kernels_named(p, tree, kernels) for p, tree in files.items()))
    entries = {kernel for kernel, decorators in kernels.items() if 'entry' in decorators}
    assert len(entries) > 50
    assert called - entries == set()
    assert entries - called == set()
