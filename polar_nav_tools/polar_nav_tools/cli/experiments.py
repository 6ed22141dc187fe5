"""`polar experiment`: the papers' tables and figures, and what they leave out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from . import experiment_spelling
from .app import app, emit_json, say

if TYPE_CHECKING:
    from ..experiments.experiment import Outcome
    from ..experiments.request import Request


class _Group(TyperGroup):
    """Subcommands of `experiment`; the spelling before them is accepted with a hint."""

    def parse_args(
        self,
        ctx: Any,  # noqa: ANN401 - a private class of Typer
        args: list[str],
    ) -> list[str]:
        """Parse the arguments as they are spelled today."""
        today = experiment_spelling.today(args)
        if today != args:
            say(experiment_spelling.hint(today))
        return super().parse_args(ctx, today)


experiment = typer.Typer(
    cls=_Group,
    no_args_is_help=True,
    help=(
        'Run an experiment of one of the two papers with our filters beside it.\n\n'
        'Polar cooperative navigation: docs/experiments.md; no DVL, fixes of a station (has-...): '
        'docs/experiments-station.md. Writes tables (Markdown, CSV), figures (PNG, SVG) and a '
        'manifest with everything that makes the same numbers again.'
    ),
    epilog='Example: `./polar experiment run table1 --quick`',
)
app.add_typer(experiment, name='experiment')

Quick = Annotated[
    bool, typer.Option('--quick', help='One seed, the shortest run that shows something.')
]
Duration = Annotated[
    float | None, typer.Option(metavar='S', help='Length of a run.', show_default='its own')
]
Seeds = Annotated[
    int | None, typer.Option(metavar='N', help='Seeds 1 to N.', show_default='its own')
]
Columns = Annotated[
    str | None, typer.Option(metavar='A,B', help='Filters to run.', show_default='its own')
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        '--set',
        metavar='NAME=VALUE',
        help='Change what a paper leaves open (docs/experiments*.md), or engine.PARAMETER.',
    ),
]
Rows = Annotated[
    str | None,
    typer.Option(
        metavar='PATTERN',
        help='Rows, as gravity_*,dvl_*,random:1-50,random-station:1-50.',
        show_default='all',
    ),
]
FirstSeed = Annotated[
    int,
    typer.Option(metavar='K', min=0, help='Seeds K to K + N - 1, where there are rows.'),
]
Jobs = Annotated[
    int | None, typer.Option(metavar='N', help='Processes.', show_default='all cores')
]
Resume = Annotated[
    bool, typer.Option('--resume', help='Go on with the runs that are there; make the others.')
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar='ADDRESS',
        help='Dask scheduler that has the runs made, as tcp://host:8786.',
        show_default='processes of this machine',
    ),
]
Out = Annotated[
    Path | None, typer.Option(metavar='DIR', help='Where files go.', show_default='reports/NAME')
]
Json = Annotated[
    bool, typer.Option('--json', help='Print the manifest and the tables as JSON on stdout.')
]


@experiment.command('list', epilog='Example: `./polar experiment list`')
def list_all() -> None:
    """List all experiments with the length and the seeds of each."""
    from ..experiments.catalog import EXPERIMENTS

    width = max(map(len, EXPERIMENTS))
    for one in EXPERIMENTS.values():
        typer.echo(f'{one.name:<{width}}  {one.doc}')
        typer.echo(f'{"":<{width}}  {one.full.duration_s:g} s, seeds 1 to {one.full.seeds}')


@experiment.command(
    'run',
    epilog='Example: `./polar experiment run table1 --quick`\n\n'
    'Names: ' + ', '.join(f'`{name}`' for name in experiment_spelling.NAMES),
)
def run_one(
    name: Annotated[str, typer.Argument(help='One of the names below.', show_default=False)],
    rows: Rows = None,
    first_seed: FirstSeed = 1,
    quick: Quick = False,
    duration: Duration = None,
    seeds: Seeds = None,
    columns: Columns = None,
    settings: Settings = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Run one experiment by its name."""
    request = _request(name, quick, duration, seeds, columns, settings, (jobs, scheduler, resume))
    chosen = replace(request, rows=rows, first_seed=first_seed)
    _run(name, chosen, _folder(out, name), as_json)


@experiment.command(
    epilog='Example: `./polar experiment ablation --sensors 6.2 --delays 0,5 --duration 600`'
)
def ablation(
    sensors: Annotated[
        str | None,
        typer.Option(
            metavar='A,B',
            help='6.1, 6.2, 6.2 without DVL, tactical.',
            show_default='those of the paper',
        ),
    ] = None,
    periods: Annotated[
        str | None, typer.Option(metavar='S,S', help='Times between fixes.', show_default='1,10')
    ] = None,
    delays: Annotated[
        str | None,
        typer.Option(metavar='S,S', help='Delays of fixes.', show_default='0,1,2,5,10,30,60'),
    ] = None,
    quick: Quick = False,
    duration: Duration = None,
    seeds: Seeds = None,
    columns: Columns = None,
    settings: Settings = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Run each delay strategy over sensors, times between fixes and delays."""
    request = replace(
        _request('ablation', quick, duration, seeds, columns, settings, (jobs, scheduler, resume)),
        sensors=_words(sensors),
        periods_s=_numbers(periods, '--periods', 0.1, 600.0),
        delays_s=_numbers(delays, '--delays', 0.0, 119.0),
    )
    _run('ablation', request, _folder(out, 'ablation'), as_json)


@experiment.command(
    epilog="Example: `./polar experiment mismatch --rows 'dvl_*' --seeds 2 --first-seed 9001`"
)
def mismatch(
    rows: Rows = None,
    first_seed: FirstSeed = 1,
    quick: Quick = False,
    seeds: Seeds = None,
    columns: Columns = None,
    settings: Settings = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Run filters in worlds with faults unknown to them: wrong, visible, reported."""
    request = _request(
        'mismatch', quick, None, seeds, columns, settings, (jobs, scheduler, resume)
    )
    chosen = replace(request, rows=rows, first_seed=first_seed)
    _run('mismatch', chosen, _folder(out, 'mismatch'), as_json)


@experiment.command(
    epilog="Example: `./polar experiment faults --rows 'imu_*' --seeds 1 --columns default`"
)
def faults(
    rows: Annotated[
        str | None,
        typer.Option(
            metavar='PATTERN', help='Faults, as imu_*,station/packet_*.', show_default='all'
        ),
    ] = None,
    first_seed: Annotated[int, typer.Option(metavar='K', min=0, help='Seeds K to K + N - 1.')] = 1,
    quick: Quick = False,
    seeds: Seeds = None,
    columns: Columns = None,
    settings: Settings = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Inject one fault of sensor, clock or packets per run: recovered, reported, silent, dead."""
    request = _request('faults', quick, None, seeds, columns, settings, (jobs, scheduler, resume))
    chosen = replace(request, rows=rows, first_seed=first_seed)
    _run('faults', chosen, _folder(out, 'faults'), as_json)


@experiment.command(
    'imu-errors', epilog='Example: `./polar experiment imu-errors BAG --duration 3600`'
)
def imu_errors(
    bag: Annotated[
        Path, typer.Argument(help='Bag recorded while the IMU rested.', show_default=False)
    ],
    name: Annotated[
        str, typer.Option('--experiment', metavar='table3|figure11', help='Which is run.')
    ] = 'table3',
    topic: Annotated[
        str, typer.Option(help='Topic of the IMU.', show_default='the only one')
    ] = '',
    mean: Annotated[
        str, typer.Option(metavar='remove|keep', help='Mean of the recording.')
    ] = 'remove',
    earth_rate: Annotated[
        str, typer.Option(metavar='remove|keep', help='Earth rate, if the mean is kept.')
    ] = 'remove',
    latitude: Annotated[float, typer.Option(help='Where the IMU rested, deg.')] = 45.0,
    heading: Annotated[float, typer.Option(help='True heading of its x axis, deg.')] = 0.0,
    quick: Quick = False,
    duration: Duration = None,
    seeds: Seeds = None,
    columns: Columns = None,
    settings: Settings = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Run table3 with the errors of your own IMU: what it reads at rest, less what it should."""
    from polar_nav_core.errors import ConfigError

    from ..experiments.recorded import RestSpec, read_rest, save_recorded

    if name not in experiment_spelling.WITH_IMU:
        names = ' and '.join(experiment_spelling.WITH_IMU)
        raise ConfigError(f'imu-errors: {name} does not use them; {names} do')
    request = _request(name, quick, duration, seeds, columns, settings, (jobs, scheduler, resume))
    spec = RestSpec(
        topic=topic,
        mean=mean,
        earth_rate=earth_rate,
        latitude_deg=latitude,
        heading_deg=heading,
    )
    errors = read_rest(bag, spec)
    folder = _folder(out, name)
    folder.mkdir(parents=True, exist_ok=True)
    recorded = save_recorded(errors, (folder / 'imu_errors.npz').resolve())
    say(f'{errors.duration_s:.0f} s of IMU errors at {errors.rate_hz:g} Hz')
    _run(name, replace(request, recorded=recorded), folder, as_json)


def _request(
    name: str,
    quick: bool,
    duration_s: float | None,
    seeds: int | None,
    columns: str | None,
    settings: list[str] | None,
    who: tuple[int | None, str | None, bool],
) -> Request:
    """Options of every experiment."""
    from polar_nav_core.errors import ConfigError

    from ..experiments.catalog import experiment_named
    from ..experiments.request import Request
    from ..tasks.cluster import default_workers

    names = _words(columns)
    choices = experiment_named(name).suite.read(settings or [], names)
    jobs, scheduler, resume = who
    if jobs is not None and jobs < 1:
        raise ConfigError(f'--jobs: {jobs} is less than 1')
    return Request(
        **choices,
        quick=quick,
        duration_s=duration_s,
        seeds=seeds,
        columns=names,
        jobs=default_workers() if jobs is None else jobs,
        scheduler=scheduler,
        resume=resume,
    )


def _folder(out: Path | None, name: str) -> Path:
    return out if out is not None else Path('reports') / name


def _run(name: str, request: Request, folder: Path, as_json: bool) -> None:
    """Run an experiment with its progress on stderr, and print its results."""
    from ..experiments.catalog import experiment_named
    from ..experiments.experiment import run
    from ..terminal.progress import progress_display

    try:
        with progress_display(name, total=1.0, unit='runs') as update:
            outcome = run(experiment_named(name), request, folder, update)
    except KeyboardInterrupt:
        say(f'finished runs are kept in {folder}; --resume goes on with them')
        raise
    if outcome.manifest['rows']['kept']:
        say(_kept(outcome.manifest))
    _print(outcome, as_json)


def _kept(manifest: Mapping[str, Any]) -> str:
    """Sentence on runs that were there before, and which sources made all of them."""
    rows = manifest['rows']
    text = f'{rows["kept"]} of {len(manifest["runs"])} runs were there already'
    if len(rows['sources']) > 1:
        made = ', '.join(f'{count} by {name}' for name, count in rows['sources'].items())
        text += f'; not all by the same sources: {made}'
    return text


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


def _print(outcome: Outcome, as_json: bool) -> None:
    if as_json:
        emit_json(
            {'ok': True, **outcome.manifest, 'tables': [t.to_dict() for t in outcome.tables]}
        )
        return
    from rich.console import Console

    from ..terminal.tables import print_table

    console = Console(highlight=False)
    for table in outcome.tables:
        print_table(console, table)
    say('wrote ' + ', '.join(str(f) for f in outcome.files))
