"""Figure of rooms and floors as SVG, drawn from the import contracts in pyproject.toml.

One block for each contract of layers: packages, and rooms inside a package. A room imports rooms
of lower floors only. Beside each room stands the first line of its docstring. `pages` writes the
figure; a test compares it with the contracts.
"""

from __future__ import annotations

import ast
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from xml.sax.saxutils import escape

_WIDTH, _MARGIN, _GAP = 1080, 20, 6
_LINE, _PAD = 15, 8
_NAMES = 170
"""Width for the name where a floor is one room; its docstring stands beside it."""
_PER_CHARACTER = 6.6
"""Upper bound of the width of a character of a docstring."""
_STYLE = """\
text { font-family: system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; fill: #1c2733; }
.title { font-size: 15px; font-weight: 600; }
.name { font-size: 13px; font-weight: 600; }
.doc { font-size: 11.5px; fill: #5a6b7b; }
.room { fill: #eef3f8; stroke: #c9d6e3; }
"""


@dataclass(frozen=True)
class Floor:
    """Rooms of one floor: none of them imports another."""

    rooms: tuple[tuple[str, str], ...]
    """Name and first line of the docstring."""


@dataclass(frozen=True)
class House:
    """A contract of layers: its title and its floors, the highest first."""

    title: str
    floors: tuple[Floor, ...]


def houses(root: Path) -> list[House]:
    """Contracts of layers of a clone, in the order of pyproject.toml."""
    document = tomllib.loads((root / 'pyproject.toml').read_text(encoding='utf-8'))
    contracts = document['tool']['importlinter']['contracts']
    return [_house(root, c) for c in contracts if c['type'] == 'layers']


def _house(root: Path, contract: dict[str, object]) -> House:
    containers = contract.get('containers') or ['']
    layers = contract['layers']
    assert isinstance(containers, list)
    assert isinstance(layers, list)
    container = str(containers[0])
    floors = []
    for layer in layers:
        names = [part.strip(' ()') for part in str(layer).replace(':', '|').split('|')]
        rooms = [(name, _first_line(root, f'{container}.{name}'.strip('.'))) for name in names]
        floors.append(Floor(tuple(rooms)))
    return House(str(contract['name']), tuple(floors))


def _first_line(root: Path, module: str) -> str:
    """First line of a module's docstring, without full stop and page of its derivation."""
    parts = module.split('.')
    base = root / parts[0] / Path(*parts)
    file = base / '__init__.py' if base.is_dir() else base.with_suffix('.py')
    text = ast.get_docstring(ast.parse(file.read_text(encoding='utf-8'))) or ''
    return re.sub(r' \(docs/[^)]*\)', '', text.partition('\n')[0]).rstrip('.')


def drawing(root: Path) -> str:
    """Figure of the contracts of a clone, an SVG document."""
    parts: list[str] = []
    y = _MARGIN
    for house in houses(root):
        parts.append(_text('title', _MARGIN, y + 14, house.title))
        y += 26
        for floor in house.floors:
            y += _floor(parts, floor, y) + _GAP
        y += _MARGIN
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {y}" role="img" '
        'aria-label="Rooms and floors of polar_nav: each imports only what stands below">'
    )
    frame = f'<rect width="{_WIDTH}" height="{y}" fill="#ffffff"/>'
    return '\n'.join([head, f'<style>\n{_STYLE}</style>', frame, *parts, '</svg>']) + '\n'


def _floor(parts: list[str], floor: Floor, y: int) -> int:
    """Height of a floor whose rooms are appended at ``y``."""
    each = (_WIDTH - 2 * _MARGIN - _GAP * (len(floor.rooms) - 1)) // len(floor.rooms)
    alone = len(floor.rooms) == 1
    left, below = (_NAMES, 0) if alone else (0, 1)
    characters = int((each - left - 2 * _PAD) / _PER_CHARACTER)
    texts = [wrap(doc, characters) for _, doc in floor.rooms]
    height = 2 * _PAD + _LINE * (below + max(len(t) for t in texts))
    for k, ((name, _), lines) in enumerate(zip(floor.rooms, texts, strict=True)):
        x = _MARGIN + k * (each + _GAP)
        parts.append(
            f'<rect class="room" x="{x}" y="{y}" width="{each}" height="{height}" rx="6"/>'
        )
        parts.append(_text('name', x + _PAD, y + _PAD + 11, name))
        for n, line in enumerate(lines, start=below):
            parts.append(_text('doc', x + left + _PAD, y + _PAD + 11 + n * _LINE, line))
    return height


def _text(kind: str, x: int, y: int, text: str) -> str:
    return f'<text class="{kind}" x="{x}" y="{y}">{escape(text)}</text>'
