"""`polar score PATTERN... --out FILE.parquet`: bags of a fleet, as tasks and rows."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from polar_nav_core.errors import ConfigError

from .app import emit_json, require, say
from .progress_of_tasks import shown

if TYPE_CHECKING:
    from ..fleet.score import Order, Outcome

_MOST_SAID = 20
_USUAL = ('default',)


def order_of(
    words: Sequence[Path],
    configurations: Sequence[str],
    out: Path,
    vehicle: str | None,
    workers: tuple[int | None, str | None],
    again: tuple[bool, bool],
) -> Order:
    """Return what is to be done, checked.

    Parameters
    ----------
    words, configurations, out, vehicle
        As named; without a configuration `default`.
    workers : tuple of int and str
        ``--jobs`` and ``--scheduler``.
    again : tuple of bool
        ``--resume`` and ``--failed``.

    Raises
    ------
    ConfigError
        For a number or a name that is none.
    """
    from polar_nav_core.engine.configurations import NAMES

    from ..fleet.score import Order
    from ..tasks.cluster import default_workers
    from ..tasks.execution import Workers

    jobs, scheduler = workers
    if jobs is not None and jobs < 1:
        raise ConfigError(f'--jobs: {jobs} is less than 1')
    unknown = [name for name in configurations if name not in NAMES]
    if unknown:
        raise ConfigError(f'no configuration {unknown[0]!r}; there are {", ".join(NAMES)}')
    count = default_workers() if jobs is None else jobs
    resume, failed = again
    return Order(
        tuple(words),
        tuple(dict.fromkeys(configurations)) or _USUAL,
        out,
        vehicle,
        Workers(count, scheduler),
        resume,
        failed,
    )


def score_fleet(order: Order, markdown: Path | None, csv: Path | None, as_json: bool) -> None:
    """Score bags, keep their rows, and print tables; status 1 unless all is well."""
    from ..analysis.score_files import write_csv, write_markdown
    from ..fleet.score import run, tables

    outcome = shown(
        run,
        order,
        title=order.out.stem,
        scheduler=order.workers.scheduler,
        kept=f'finished rows are kept beside {order.out}',
    )
    found = tables(outcome)
    if markdown is not None:
        write_markdown(markdown, found)
    if csv is not None:
        write_csv(csv, found)
    _remark(outcome)
    complaints = outcome.complaints()
    if as_json:
        emit_json(_document(outcome, complaints))
    else:
        from rich.console import Console

        from ..terminal.tables import print_table

        console = Console(highlight=False)
        for table in found:
            print_table(console, table)
        sys.stdout.flush()
        say(f'wrote {outcome.out}')
    for text in complaints[:_MOST_SAID]:
        say(text)
    if len(complaints) > _MOST_SAID:
        say(f'and {len(complaints) - _MOST_SAID} more; {outcome.out} has them all')
    if outcome.failed:
        say(f'{len(outcome.failed)} failed: --failed makes them again')
    require(not complaints)


def _remark(outcome: Outcome) -> None:
    if outcome.kept:
        say(f'{outcome.kept} of {len(outcome.scored)} rows were there already')
    if outcome.uncertain:
        say(
            f'of {outcome.uncertain} bags the storage states the size only, neither an ETag nor a '
            'time: one that changes and keeps its size is not scored again'
        )


def _document(outcome: Outcome, complaints: Sequence[str]) -> dict[str, object]:
    from ..fleet.score import tables

    return {
        'ok': not complaints,
        'out': str(outcome.out),
        'bags': outcome.bags,
        'rows': len(outcome.scored),
        'kept': outcome.kept,
        'failed': len(outcome.failed),
        'complaints': list(complaints),
        'tables': [table.to_dict() for table in tables(outcome)],
    }
