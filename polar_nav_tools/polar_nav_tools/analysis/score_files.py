"""Scores of several bags as one comparison, and as files: Markdown for people, CSV for tables."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import writing

from ..scoring import Comparison, Table
from ..scoring.delivery import delivery_table

if TYPE_CHECKING:
    from .analyse import Analysis


_JUDGEMENTS = ('judgement', 'honesty', 'worst_quantity', 'worst_band')
"""Columns with texts that are figures, not part of a row's name."""


def label_bags(bags: Sequence[Path]) -> dict[str, Path]:
    """Labels of bags in tables: folder names, or whole paths where two are the same.

    Raises
    ------
    ConfigError
        When a bag is named twice.
    """
    names = [bag.resolve().name for bag in bags]
    labels = [n if names.count(n) == 1 else str(b) for n, b in zip(names, bags, strict=True)]
    if len(set(labels)) != len(labels):
        twice = next(label for label in labels if labels.count(label) > 1)
        raise ConfigError(f'{twice} is named twice')
    return dict(zip(labels, bags, strict=True))


def side_by_side(comparisons: Mapping[str, Comparison]) -> Comparison:
    """One comparison of the runs of several bags, named by bag and run."""
    if len(comparisons) == 1:
        return next(iter(comparisons.values()))
    return Comparison(
        {
            f'{label}: {name}': one
            for label, comparison in comparisons.items()
            for name, one in comparison.scores.items()
        },
        {
            f'{label}: {name}': one
            for label, comparison in comparisons.items()
            for name, one in comparison.models.items()
        },
    )


def tables_of(comparison: Comparison, analyses: Mapping[str, Analysis]) -> list[Table]:
    """All tables of a comparison, with the delivery of packets of each bag."""
    deliveries = {
        label: delivery_table(one.delivery)
        for label, one in analyses.items()
        if one.delivery is not None
    }
    several = len(analyses) > 1
    return [
        *comparison.tables(),
        *(
            Table(f'{table.title}, {label}' if several else table.title, table.columns, table.rows)
            for label, table in deliveries.items()
        ),
    ]


def write_markdown(path: Path, tables: Sequence[Table]) -> None:
    """Write tables as Markdown, one below the other; an older file is replaced."""
    with writing(path):
        path.write_text('\n'.join(table.to_markdown() for table in tables), encoding='utf-8')


def write_csv(path: Path, tables: Sequence[Table]) -> None:
    """Write every number of the tables on a line of its own, unrounded; replaces an older file.

    ``table,row,figure,unit,value``: a row is named by the texts in it. Empty where there is no
    number.
    """
    with writing(path), path.open('w', encoding='utf-8', newline='') as stream:
        writer = csv.writer(stream, lineterminator='\n')
        writer.writerow(['table', 'row', 'figure', 'unit', 'value'])
        for table in tables:
            first = table.columns[0].key
            for row in table.rows:
                texts = [c for c in table.columns if isinstance(row.get(c.key), str)]
                name = ' / '.join(str(row[c.key]) for c in texts if c.key not in _JUDGEMENTS)
                for column in table.columns:
                    judged = column.key in _JUDGEMENTS and column.key != first
                    if column in texts and not judged:
                        continue
                    value = row.get(column.key)
                    writer.writerow([table.title, name, column.key, column.unit, _cell(value)])


def _cell(value: object) -> object:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ''
    return repr(float(value)) if isinstance(value, float) else value
