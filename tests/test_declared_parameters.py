"""Every declared parameter does something: code outside of its declaration reads it."""

import ast
import inspect
from dataclasses import fields
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

from polar_nav_core.params import NodeParams
from polar_nav_core.retired import RETIRED
from polar_nav_tools.development.pages import NODES

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
PACKAGES = ('core', 'ros', 'sim', 'leader', 'follower', 'tools')
DECLARING = {
    base.__name__
    for cls in NODES.values()
    for base in inspect.getmro(cls)
    if issubclass(base, NodeParams)
}


def names_read(tree):
    """Attributes that are read, and texts: some parameters are looked up by their name."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            found.add(node.attr)
        elif isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'getattr':
            found |= {c.value for c in ast.walk(node) if isinstance(c, ast.Constant)}
    return found


def reads(trees):
    """Names read outside of the declaring classes, or in a method of theirs that is called there.

    A check at construction alone (`__post_init__`) is no use of a value.
    """
    outside, methods = set(), {}
    for tree in trees:
        for node in list(ast.walk(tree)):
            if isinstance(node, ast.ClassDef) and node.name in DECLARING:
                for part in node.body:
                    if isinstance(part, ast.FunctionDef):
                        methods.setdefault(part.name, set()).update(names_read(part))
                node.body = []
        outside |= names_read(tree)
    called = outside & methods.keys()
    done = set()
    while called - done:
        method = (called - done).pop()
        done.add(method)
        outside |= methods[method]
        called |= methods[method] & methods.keys()
    return outside


@pytest.fixture(scope='module')
def read():
    files = [
        path
        for package in PACKAGES
        for path in sorted((ROOT / f'polar_nav_{package}' / f'polar_nav_{package}').rglob('*.py'))
    ]
    assert len(files) > 200
    return reads([ast.parse(path.read_text(encoding='utf-8')) for path in files])


@pytest.mark.parametrize('node', NODES)
def test_each_parameter_of_a_node_is_read(read, node):
    unread = {f.name for f in fields(NODES[node])} - read
    assert not unread, f'{node} declares what nothing reads: {sorted(unread)}'


def test_a_name_that_was_retired_is_not_declared_again():
    declared = {f.name for cls in NODES.values() for f in fields(cls)}
    assert not declared & RETIRED.keys()
