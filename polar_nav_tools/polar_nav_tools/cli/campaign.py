"""`polar campaign`: many runs over seeds and parameters, on this machine or a Dask scheduler."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, require, say
from .arguments import existing
from .experiments import Scheduler
from .progress_of_tasks import shown

if TYPE_CHECKING:
    from ..campaign.campaign import Outcome
    from ..campaign.spec import Spec


_IN_THE_FILE = ('Quantiles over runs', 'Normalized squared error')
"""Tables that are too long for a terminal."""


@app.command(epilog='Example: `./polar campaign SPEC.yaml --runs 1000 --resume`, docs/scale.md')
def campaign(
    spec: Annotated[
        Path,
        typer.Argument(
            metavar='SPEC.yaml',
            help='What is run, what varies, what is drawn (docs/scale.md).',
            show_default=False,
            callback=existing,
        ),
    ],
    runs: Annotated[int, typer.Option(metavar='N', help='Runs of every combination.')] = 10,
    first_seed: Annotated[int, typer.Option(metavar='K', min=0, help='Seeds K to K + N - 1.')] = 1,
    scheduler: Scheduler = None,
    jobs: Annotated[
        int | None,
        typer.Option(metavar='N', help='Processes of this machine.', show_default='all cores'),
    ] = None,
    resume: Annotated[
        bool, typer.Option('--resume', help='Go on with the rows of DIR; make the others.')
    ] = False,
    failed: Annotated[
        bool, typer.Option('--failed', help='Make those again that failed, here, one by one.')
    ] = False,
    only: Annotated[
        str | None,
        typer.Option(metavar='KEY', help='Make this run only, here; write nothing.'),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='Where files go.', show_default='reports/SPEC'),
    ] = None,
    as_json: Annotated[
        bool, typer.Option('--json', help='Print manifest and tables as JSON on stdout.')
    ] = False,
) -> None:
    """Run a campaign: any mission, configuration, mismatch and fault over seeds; no DDS."""
    from polar_nav_core.errors import ConfigError

    from ..campaign.campaign import Order, default_folder, run
    from ..campaign.spec import read
    from ..tasks.cluster import default_workers
    from ..tasks.execution import Workers

    if jobs is not None and jobs < 1:
        raise ConfigError(f'--jobs: {jobs} is less than 1')
    stated = read(spec)
    folder = out if out is not None else default_folder(spec)
    if only is not None:
        _only(stated, runs, first_seed, only, folder)
        return
    workers = Workers(default_workers() if jobs is None else jobs, scheduler)
    order = Order(stated, runs, first_seed, folder, workers, resume, failed)
    outcome = shown(
        run,
        order,
        title=spec.stem,
        scheduler=scheduler,
        kept=f'finished runs are kept in {folder}',
    )
    _print(outcome, as_json)
    require(outcome.failures == 0)


def _only(spec: Spec, runs: int, first_seed: int, key: str, folder: Path) -> None:
    """Make one run here; compare it with its row, if there is one."""
    from ..campaign.campaign import only
    from ..scoring.json_values import record
    from ..tasks.store import opened

    row, result = only(spec, runs, first_seed, key)
    known = None
    if folder.is_dir():
        with opened(folder) as store:
            known = store.rows.get(row.key)
    names = {**row.names, 'key': row.key, 'status': row.status, 'reason': row.reason}
    metrics = {} if result is None else dict(result.metrics)
    emit_json(record({**names, 'where': row.where, 'metrics': metrics}))
    if known is None:
        say(f'{folder} has no row of it to compare with')
        return
    same = (known.status, known.reason, known.content) == (row.status, row.reason, row.content)
    say(f'{"equal, bit for bit, to" if same else "differs from"} the row in {folder}')
    require(same)


def _print(outcome: Outcome, as_json: bool) -> None:
    runs = outcome.manifest['runs']
    if runs['kept']:
        say(f'{runs["kept"]} of {runs["all"]} runs were there already')
    if as_json:
        tables = [t.to_dict() for t in outcome.tables]
        emit_json({'ok': not outcome.failures, **outcome.manifest, 'tables': tables})
        return
    from rich.console import Console

    from ..terminal.tables import print_table

    console = Console(highlight=False)
    for table in outcome.tables:
        if table.title not in _IN_THE_FILE:
            print_table(console, table)
    sys.stdout.flush()
    say('wrote ' + ', '.join(str(f) for f in outcome.files))
    if outcome.failures:
        say(f'{outcome.failures} runs failed: --failed makes them again, here, one by one')
