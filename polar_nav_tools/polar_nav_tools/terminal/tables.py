"""Tables and facts on a terminal, also on a narrow one."""

from __future__ import annotations

import sys

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table as RichTable

from ..bags.info import BagInfo
from ..bags.missing import stamp_text
from ..scoring import Table

_MOST_COLUMNS = 4
"""Number of runs that fit beside each other on a narrow terminal."""
_MOST_LAID_OUT = 1000
"""Topics whose table is laid out, which takes 0.3 ms for each; more are plain lines."""
_INFO_TITLES = ('topic', 'type', 'messages', 'Hz')


def print_table(console: Console, table: Table) -> None:
    """Print a table; one that is too wide is transposed."""
    natural = table.to_rich()
    endless = console.options.update(max_width=10_000)
    width = Measurement.get(console, endless, natural).maximum
    if width > console.width and len(table.rows) <= _MOST_COLUMNS:
        console.print(_turned(table))
    elif console.is_terminal:
        console.print(natural)
    else:
        # A file has no width.
        Console(file=console.file, width=max(width, console.width), highlight=False).print(natural)


def _turned(table: Table) -> RichTable:
    first, *others = table.columns
    turned = RichTable(title=table.title, caption=table.note or None, box=box.SIMPLE_HEAD)
    turned.title_justify = turned.caption_justify = 'left'
    turned.add_column(first.title)
    turned.add_column('')
    cells = table.cells()
    for row in cells:
        turned.add_column(escape(row[0]), justify='right', overflow='fold')
    for i, column in enumerate(others, start=1):
        values = [escape(row[i]) for row in cells]
        turned.add_row(escape(column.title), escape(column.unit), *values)
    return turned


def print_info(facts: BagInfo) -> None:
    """Print the facts of a bag on stdout."""
    console = Console(highlight=False)
    ratio = facts.uncompressed_bytes / facts.size_bytes if facts.size_bytes else 0.0
    lines = {
        'bag': facts.path,
        'files': ', '.join(facts.files),
        'size': f'{size_text(facts.size_bytes)}, {facts.compression}, {ratio:.1f} times smaller',
        'written by': facts.library,
        'from': stamp_text(facts.start_ns),
        'to': stamp_text(facts.stop_ns),
        'duration': f'{facts.duration_s:.1f} s',
        'messages': f'{facts.message_count}',
        'complete': _complete_text(facts),
    }
    for key in ('mission', 'seed', 'pace', 'configuration', 'git_commit', 'replay_of'):
        value = facts.run_info.get(key)
        if value not in (None, ''):
            lines[key.replace('_', ' ')] = str(value)
    for name, value in lines.items():
        console.print(f'{name:>14}  {escape(value)}', soft_wrap=True)
    rows = [
        (t.name, t.type, str(t.count), '' if t.rate_hz is None else f'{t.rate_hz:.3g}')
        for t in facts.topics
    ]
    if len(rows) > _MOST_LAID_OUT:
        sys.stdout.writelines(f'{" ".join(row)}\n' for row in [_INFO_TITLES, *rows])
        return
    table = RichTable(box=box.SIMPLE_HEAD)
    for number, title in enumerate(_INFO_TITLES):
        if number < 2:
            table.add_column(title, overflow='fold')
        else:
            table.add_column(title, justify='right')
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)


def _complete_text(facts: BagInfo) -> str:
    if not facts.is_complete:
        return 'no'
    return 'yes' if facts.is_verified else 'yes, by its index; `polar doctor` reads it all'


def size_text(count: int) -> str:
    """Text of a number of bytes, with unit."""
    size = float(count)
    for unit in ('B', 'kB', 'MB'):
        if size < 1000.0:
            return f'{size:.3g} {unit}'
        size /= 1000.0
    return f'{size:.3g} GB'
