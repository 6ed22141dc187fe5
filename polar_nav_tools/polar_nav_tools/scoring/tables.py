"""Tables for terminal, Markdown, CSV, JSON and HTML.

Numbers are rounded only here, to significant digits, so that 0.0123 m and 15.1 m stand in one
column and both can be read. CSV and JSON keep every digit.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .json_values import record

if TYPE_CHECKING:
    from rich.table import Table as RichTable

MISSING = '–'


@dataclass(frozen=True)
class Column:
    """Heading of one column."""

    key: str  # name in CSV and JSON, with the unit where it is not SI
    title: str
    unit: str = ''
    digits: int = 3  # significant digits shown for floats
    doc: str = ''  # one sentence, shown as a tooltip in the report

    @property
    def heading(self) -> str:
        """Title with unit."""
        return f'{self.title} [{self.unit}]' if self.unit else self.title


@dataclass(frozen=True)
class Table:
    """Rows of values under named columns; a key missing from a row is an empty cell."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[Mapping[str, object], ...]
    note: str = ''

    def __post_init__(self) -> None:
        keys = [c.key for c in self.columns]
        if len(set(keys)) != len(keys):
            raise ValueError(f'table {self.title!r}: column keys are not unique: {keys}')
        for row in self.rows:
            unknown = sorted(set(row) - set(keys))
            if unknown:
                raise ValueError(f'table {self.title!r}: no column for {unknown}')

    def cells(self) -> list[list[str]]:
        """Rounded text of every cell, row by row."""
        return [[show(row.get(c.key), c.digits) for c in self.columns] for row in self.rows]

    def numeric(self, column: Column) -> bool:
        """Whether the column holds numbers only (then it is set flush right)."""
        values = [row.get(column.key) for row in self.rows]
        present = [v for v in values if v is not None]
        return bool(present) and all(_is_number(v) for v in present)

    def records(self) -> list[dict[str, object]]:
        """Rows as plain data, unrounded."""
        return [record({c.key: r.get(c.key) for c in self.columns}) for r in self.rows]

    def to_dict(self) -> dict[str, object]:
        """Columns and rows as plain data, unrounded."""
        return {
            'title': self.title,
            'columns': [
                {'key': c.key, 'title': c.title, 'unit': c.unit, 'doc': c.doc}
                for c in self.columns
            ],
            'rows': self.records(),
            'note': self.note,
        }

    def to_markdown(self) -> str:
        """GitHub-flavoured table with a heading line, aligned for reading as plain text too."""
        head = [_escaped(c.heading) for c in self.columns]
        body = [[_escaped(cell) for cell in row] for row in self.cells()]
        widths = [max([3, len(h), *(len(r[i]) for r in body)]) for i, h in enumerate(head)]
        right = [self.numeric(c) for c in self.columns]

        def line(cells: Sequence[str]) -> str:
            padded = [
                cell.rjust(w) if r else cell.ljust(w)
                for cell, w, r in zip(cells, widths, right, strict=True)
            ]
            return '| ' + ' | '.join(padded) + ' |'

        rule = ['-' * (w - 1) + ':' if r else '-' * w for w, r in zip(widths, right, strict=True)]
        parts = [f'**{self.title}**', '', line(head), line(rule), *(line(r) for r in body)]
        if self.note:
            parts += ['', self.note]
        return '\n'.join(parts) + '\n'

    def to_csv(self) -> str:
        """Comma-separated values under the column keys, unrounded; empty without a number."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator='\n')
        writer.writerow([c.key for c in self.columns])
        for row in self.rows:
            writer.writerow([_csv_cell(row.get(c.key)) for c in self.columns])
        return out.getvalue()

    def to_rich(self) -> RichTable:
        """Table for the terminal."""
        from rich import box  # here: a score as JSON need not load it
        from rich.table import Table as RichTable

        table = RichTable(title=self.title, caption=self.note or None, box=box.SIMPLE_HEAD)
        table.title_justify = table.caption_justify = 'left'
        for column in self.columns:
            heading = f'{column.title}\n[dim]{_plain(column.unit)}[/dim]'
            table.add_column(heading, justify='right' if self.numeric(column) else 'left')
        for row in self.cells():
            table.add_row(*(_plain(cell) for cell in row))
        return table


def show(value: object, digits: int = 3) -> str:
    """Text of a value with `digits` significant digits, no exponent between 1e-4 and 1e6."""
    if value is None:
        return MISSING
    if isinstance(value, (bool, np.bool_)):
        return 'yes' if value else 'no'
    if isinstance(value, (int, np.integer)):
        return f'{int(value)}'
    if isinstance(value, (float, np.floating)):
        return _show_float(float(value), digits)
    return str(value)


def _show_float(value: float, digits: int) -> str:
    if math.isnan(value):
        return MISSING
    if math.isinf(value):
        return '∞' if value > 0 else '−∞'
    if value == 0.0:
        return '0'
    if not 1e-4 <= abs(value) < 1e6:
        return f'{value:.{digits - 1}e}'.replace('-', '−')
    rounded = float(f'{value:.{digits - 1}e}')
    exponent = math.floor(math.log10(abs(rounded)))
    return f'{value:.{max(0, digits - 1 - exponent)}f}'.replace('-', '−')


def _is_number(value: object) -> bool:
    number = isinstance(value, (int, float, np.integer, np.floating))
    return number and not isinstance(value, bool)


def _csv_cell(value: Any) -> object:  # noqa: ANN401 - whatever a row holds
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ''
    return repr(float(value)) if isinstance(value, (float, np.floating)) else value


def _escaped(text: str) -> str:
    return text.replace('|', '\\|').replace('\n', ' ')


def _plain(text: str) -> str:
    from rich.markup import escape

    return escape(text)
