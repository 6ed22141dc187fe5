"""`polar experiment`: the paper's tables and figures, and what it leaves out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, say

if TYPE_CHECKING:
    from ..experiments.experiment import Outcome

_REST = '(--imu-errors)'


def _list(value: bool) -> None:
    if not value:
        return
    from ..experiments.catalog import EXPERIMENTS

    width = max(map(len, EXPERIMENTS))
    for experiment in EXPERIMENTS.values():
        size = experiment.full
        typer.echo(f'{experiment.name:<{width}}  {experiment.doc}')
        typer.echo(f'{"":<{width}}  {size.duration_s:g} s, seeds 1 to {size.seeds}')
    raise typer.Exit


@app.command(
    epilog='Example: `./polar experiment table1 --quick`\n\n'
    'Own IMU: `./polar experiment table3 --imu-errors BAG --duration 3600`'
)
def experiment(
    name: Annotated[str, typer.Argument(help='Which; --list tells.', show_default=False)],
    list_all: Annotated[
        bool,
        typer.Option('--list', callback=_list, is_eager=True, help='Name all and end.'),
    ] = False,
    quick: Annotated[
        bool, typer.Option('--quick', help='One seed, the shortest run that shows something.')
    ] = False,
    duration: Annotated[
        float | None, typer.Option(metavar='S', help='Length of a run.', show_default='its own')
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(metavar='N', help='Seeds 1 to N.', show_default='its own')
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(metavar='A,B', help='Filters to run.', show_default='its own'),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            '--set',
            metavar='NAME=VALUE',
            help='Change what a paper leaves open (docs/experiments*.md), or engine.PARAMETER.',
        ),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(metavar='N', help='Processes.', show_default='all cores')
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='Where files go.', show_default='reports/NAME'),
    ] = None,
    sensors: Annotated[
        str | None,
        typer.Option(
            metavar='A,B', help='ablation: 6.1, 6.2, 6.2 without DVL.', show_default='all'
        ),
    ] = None,
    periods: Annotated[
        str | None,
        typer.Option(metavar='S,S', help='ablation: times between fixes.', show_default='1,10'),
    ] = None,
    delays: Annotated[
        str | None,
        typer.Option(
            metavar='S,S', help='ablation: delays of fixes.', show_default='0,1,2,5,10,30,60'
        ),
    ] = None,
    rows: Annotated[
        str | None,
        typer.Option(
            metavar='PATTERN', help='mismatch: faults, as gravity_*,dvl_*.', show_default='all'
        ),
    ] = None,
    first_seed: Annotated[
        int | None,
        typer.Option(metavar='K', help='mismatch: seeds K to K + N - 1.', show_default='1'),
    ] = None,
    imu_errors: Annotated[
        Path | None,
        typer.Option(metavar='BAG', help='table3: errors of the IMU that rested in this bag.'),
    ] = None,
    imu_topic: Annotated[
        str, typer.Option(help=f'Its topic {_REST}.', show_default='the only one')
    ] = '',
    imu_mean: Annotated[
        str, typer.Option(metavar='remove|keep', help=f'Mean of the recording {_REST}.')
    ] = 'remove',
    imu_earth_rate: Annotated[
        str,
        typer.Option(metavar='remove|keep', help=f'Earth rate, if the mean is kept {_REST}.'),
    ] = 'remove',
    imu_latitude: Annotated[float, typer.Option(help=f'Where it rested, deg {_REST}.')] = 45.0,
    imu_heading: Annotated[float, typer.Option(help=f'True heading of its x, deg {_REST}.')] = 0.0,
    as_json: Annotated[
        bool, typer.Option('--json', help='Print the manifest and the tables as JSON on stdout.')
    ] = False,
) -> None:
    """Run an experiment of one of the two papers with our filters beside it.

    Polar cooperative navigation: docs/experiments.md; no DVL, fixes of a station (has-...):
    docs/experiments-station.md. Writes tables (Markdown, CSV), figures (PNG, SVG) and a manifest
    with everything that makes the same numbers again.
    """
    del list_all
    from polar_nav_core.errors import ConfigError

    from ..experiments.catalog import experiment_named
    from ..experiments.experiment import run
    from ..experiments.recorded import RestSpec, read_rest, save_recorded
    from ..experiments.request import Request
    from ..experiments.runner import default_workers
    from ..terminal.progress import progress_display

    chosen = experiment_named(name)
    names = _words(columns)
    choices = chosen.suite.read(settings or [], names)
    if name != 'ablation' and (sensors or periods or delays):
        raise ConfigError(f'--sensors, --periods, --delays: {name} does not use them')
    if name != 'mismatch' and (rows or first_seed is not None):
        raise ConfigError(f'--rows, --first-seed: {name} does not use them')
    if first_seed is not None and first_seed < 0:
        raise ConfigError(f'--first-seed: {first_seed} is negative')
    if jobs is not None and jobs < 1:
        raise ConfigError(f'--jobs: {jobs} is less than 1')
    folder = out if out is not None else Path('reports') / name
    recorded = None
    if imu_errors is not None:
        if name not in ('table3', 'figure11'):
            raise ConfigError(f'--imu-errors: {name} does not use it; table3 and figure11 do')
        rest = RestSpec(
            topic=imu_topic,
            mean=imu_mean,
            earth_rate=imu_earth_rate,
            latitude_deg=imu_latitude,
            heading_deg=imu_heading,
        )
        errors = read_rest(imu_errors, rest)
        folder.mkdir(parents=True, exist_ok=True)
        recorded = save_recorded(errors, (folder / 'imu_errors.npz').resolve())
        say(f'{errors.duration_s:.0f} s of IMU errors at {errors.rate_hz:g} Hz')
    request = Request(
        **choices,
        quick=quick,
        duration_s=duration,
        seeds=seeds,
        columns=names,
        jobs=default_workers() if jobs is None else jobs,
        recorded=recorded,
        sensors=_words(sensors),
        periods_s=_numbers(periods, '--periods', 0.1, 600.0),
        delays_s=_numbers(delays, '--delays', 0.0, 119.0),
        rows=rows,
        first_seed=1 if first_seed is None else first_seed,
    )
    with progress_display(name, total=1.0, unit='runs') as update:
        outcome = run(chosen, request, folder, update)
    _tell(outcome, as_json)


def _words(text: str | None) -> list[str] | None:
    """Comma-separated words; None for none."""
    return [word.strip() for word in (text or '').split(',') if word.strip()] or None


def _numbers(text: str | None, option: str, low: float, high: float) -> list[float] | None:
    """Comma-separated numbers within limits; None for none."""
    from polar_nav_core.errors import ConfigError

    values = []
    for word in _words(text) or ():
        try:
            value = float(word)
        except ValueError as error:
            raise ConfigError(f'{option}: {word!r} is not a number') from error
        if not low <= value <= high:
            raise ConfigError(f'{option}: {word} is outside of [{low:g}, {high:g}] s')
        values.append(value)
    return values or None


def _tell(outcome: Outcome, as_json: bool) -> None:
    if as_json:
        emit_json({**outcome.manifest, 'tables': [t.to_dict() for t in outcome.tables]})
        return
    from rich.console import Console

    from ..terminal.tables import print_table

    console = Console(highlight=False)
    for table in outcome.tables:
        print_table(console, table)
    say('wrote ' + ', '.join(str(f) for f in outcome.files))
