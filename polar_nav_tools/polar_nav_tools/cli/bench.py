"""`polar bench`: measurements beside peers."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from polar_nav_core.errors import ConfigError

from .app import app, emit_json, have_the_machine, require, say
from .arguments import AcceptOption, MapOption, MsgPathOption, existing
from .bags import VehicleOption
from .mapped import open_mapped

if TYPE_CHECKING:
    from polar_nav_core.engine.inputs import Inputs
    from polar_nav_core.engine.params import EngineParams

    from ..scoring import Table

bench = typer.Typer(
    no_args_is_help=True,
    help='Time what polar_nav does beside other programs that do the same work.',
    epilog='Example: `./polar bench core`',
)
app.add_typer(bench, name='bench')

_PICTURES = ('.svg', '.png', '.pdf')


CoreOption = Annotated[
    int | None,
    typer.Option(
        '--core',
        metavar='N',
        help='Run on this core.',
        show_default='the last that is allowed',
    ),
]
BagsOption = Annotated[
    Path | None,
    typer.Option(
        '--folder',
        metavar='FOLDER',
        help='Where the bags are kept.',
        show_default='a folder among temporary files',
    ),
]
JsonOption = Annotated[bool, typer.Option('--json', help='Print figures as JSON on stdout.')]


def _existing(bags: list[Path] | None) -> list[Path] | None:
    return None if bags is None else [existing(bag) for bag in bags]


@bench.command(
    epilog='Example: `./polar bench core`\n\nQuick look: `./polar bench core --rounds 1`'
)
def core(
    rounds: Annotated[int, typer.Option(min=1, help='Rounds; ratios are their medians.')] = 7,
    samples: Annotated[
        int, typer.Option(min=1, max=360_000, help='IMU samples in the record, 100 per second.')
    ] = 60_000,
    processor: CoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Time strapdown beside python-ins, and the filter beside filterpy.

    Results are compared first: when they differ, nothing is timed. Times are processor times on
    one core; on a shared machine only the ratios mean something, each taken within a round.
    """
    used = _one_core(processor)  # before anything numerical is loaded
    from ..benchmarks.core import DISTRIBUTIONS, run

    with _facts_of(DISTRIBUTIONS, used) as facts:
        result = run(samples=samples, rounds=rounds, report=say)
    if as_json:
        emit_json({'ok': True, 'machine': facts, **result.to_dict()})
        return
    _print_tables(group.table() for group in result.groups)
    worst = max(v for k, v in result.agreement_m.items() if 'horizontal' in k)
    covariance = max(result.agreement_covariance.values())
    sys.stdout.write(
        f'Same results: positions within {1e3 * worst:.1f} mm horizontally of python-ins after'
        f' {result.compared_samples} samples, covariances within {covariance:.0e}'
        ' of filterpy.\n' + _machine(facts, rounds)
    )


@bench.command(
    epilog='Example: `./polar bench delay --figure delay.svg`\n\n'
    'Quick look: `./polar bench delay --rounds 1 --seconds 120`'
)
def delay(
    rounds: Annotated[int, typer.Option(min=1, help='Rounds; ratios are their medians.')] = 7,
    seconds: Annotated[
        float, typer.Option(min=90.0, max=3600.0, help='Length of the whole runs.')
    ] = 300.0,
    figure: Annotated[
        Path | None,
        typer.Option(metavar='FILE', help='Draw a picture; .svg, .png or .pdf.'),
    ] = None,
    processor: CoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Time late fixes by each strategy, and the same work stepped with Stone Soup.

    Results are compared first: when they differ, nothing is timed. Times are processor times on
    one core; on a shared machine only the ratios mean something, each taken within a round.
    """
    if figure is not None and figure.suffix.lower() not in _PICTURES:
        raise ConfigError(f'--figure {figure}: the name must end in {", ".join(_PICTURES)}')
    used = _one_core(processor)  # before anything numerical is loaded
    from ..benchmarks.delay import DISTRIBUTIONS, run

    with _facts_of(DISTRIBUTIONS, used) as facts:
        result = run(rounds=rounds, run_s=seconds, report=say)
    if figure is not None:
        from ..benchmarks.delay_figure import write_figure

        write_figure(result, figure)
        say(f'picture: {figure}')
    if as_json:
        emit_json({'ok': True, 'machine': facts, **result.to_dict()})
        return
    _print_tables(result.tables())
    sigma, peer = max(result.agreement_sigma.values()), max(result.agreement_peer.values())
    sys.stdout.write(
        f'Same results: clone within {sigma:.1g} sigma of rewind, Stone Soup within {peer:.0e}'
        ' sigma of both.\n' + _machine(facts, rounds)
    )


@bench.command(
    epilog='Example: `./polar bench replay`\n\n'
    'Quick look: `./polar bench replay --hours 0.2 --rounds 1`'
)
def replay(
    hours: Annotated[
        float, typer.Option(min=0.05, max=48.0, help='Length of the recorded run.')
    ] = 12.0,
    rounds: Annotated[int, typer.Option(min=1, help='Rounds; ratios are their medians.')] = 5,
    folder: BagsOption = None,
    processor: CoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Time a long bag from its bytes to scored estimates, beside other ways to read bags.

    The bag is simulated and kept: 12 h are about 350 MB. What is decoded is compared bit for bit
    first. Others are timed on ten minutes of it, and scaled. Times are processor times on one
    core.
    """
    used = _one_core(processor)  # before anything numerical is loaded
    from ..benchmarks.replay import DISTRIBUTIONS, run

    with _facts_of(DISTRIBUTIONS, used) as facts:
        result = run(hours=hours, rounds=rounds, report=say, folder=folder)
    if as_json:
        emit_json({'ok': True, 'machine': facts, **result.to_dict()})
        return
    _print_tables(result.tables())
    compared = ', '.join(f'{name} {count}' for name, count in result.agreement.items())
    sys.stdout.write(
        f'Same bits, values compared: {compared}.\n'
        f'{result.real_time:.0f} times real time; others scaled from {result.part_minutes:g} min;'
        f' peak memory {result.peak_mb:.0f} MB.\n' + _machine(facts, rounds)
    )


@bench.command(
    epilog='Example: `./polar bench memory --hours 24 --beside bags/reference_10`\n\n'
    'Quick look: `./polar bench memory --hours 0.2`'
)
def memory(
    hours: Annotated[
        float, typer.Option(min=0.05, max=48.0, help='Length of the recorded run.')
    ] = 4.0,
    beside: Annotated[
        Path | None,
        typer.Option(
            metavar='BAG', help='Short recording.', show_default='a minute of the same run'
        ),
    ] = None,
    folder: BagsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure the peak memory of replay, score and smooth on a long bag beside a short one.

    Each runs in a process of its own. Temporary files (`TMPDIR`) take what memory does not: they
    want a disk, not a file system in memory. Exit status 1 when a goal is missed.
    """
    have_the_machine('measurements wait')
    from ..benchmarks.memory import run, table

    found = run(hours=hours, beside=beside, folder=folder, report=say)
    if as_json:
        commands = [one.to_dict() for one in found]
        emit_json({'ok': all(one.met for one in found), 'hours': hours, 'commands': commands})
    else:
        _print_tables([table(hours, found)])
    if not all(one.met for one in found):
        raise typer.Exit(1)


@bench.command(
    epilog='Example: `./polar bench live`\n\n'
    'Quick look: `./polar bench live --rate 100 --seconds 5`'
)
def live(
    rate: Annotated[
        list[int] | None,
        typer.Option(
            min=10, max=2000, help='IMU samples per second.', show_default='100, 200 and 400'
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(min=1.0, help='Length of each run.')] = 20.0,
    as_json: JsonOption = False,
) -> None:
    """Time a live follower: from an IMU sample to odometry/now of it, and its processor time.

    Both ways through the middleware are in it. Only an idle machine shows what the follower does.
    """
    have_the_machine('measurements wait')
    from ..benchmarks.live import RATES, run, table

    with _facts_of() as facts:
        found = run(rate or RATES, seconds, report=say)
    if as_json:
        emit_json({'machine': facts, 'rates': [asdict(one) for one in found]})
        return
    _print_tables([table(found)])
    sys.stdout.write(_cores(facts))


@bench.command(
    epilog='Example: `./polar bench smooth`\n\n'
    'Quick look: `./polar bench smooth --seconds 60 --rounds 1`\n\n'
    'Recordings: `./polar bench smooth bags/dive_1 bags/dive_2`'
)
def smooth(
    bags: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar='[BAG...]',
            help='Recordings to smooth; without one a run is simulated.',
            show_default=False,
            callback=_existing,
        ),
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help='Rounds; ratios are their medians.')] = 5,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=30.0, max=3600.0, help='Length of the simulated run.', show_default='600'
        ),
    ] = None,
    vehicle: VehicleOption = None,
    mapping: MapOption = None,
    accept: AcceptOption = None,
    msg_path: MsgPathOption = None,
    processor: CoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Time the passes of the smoother beside the filter, and beside GTSAM where it is installed.

    GTSAM solves the same linear problem, and has to find the same means and sigmas first. Times
    are processor times on one core; reading a recording is not in them.
    """
    if bags and seconds is not None:
        raise typer.BadParameter('a bag is timed as long as it is', param_hint='--seconds')
    if not bags and vehicle is not None:
        raise typer.BadParameter('goes with a bag', param_hint='--vehicle')
    if mapping is not None and not bags:
        raise typer.BadParameter('goes with a bag', param_hint='--map')
    if mapping is None and (accept or msg_path is not None):
        raise typer.BadParameter('goes with --map', param_hint='--accept, --msg-path')
    used = _one_core(processor)  # before anything numerical is loaded
    from ..benchmarks.smooth import DISTRIBUTIONS, DURATION_S, run, run_recorded

    problems: list[object] = []
    with _facts_of(DISTRIBUTIONS, used) as facts:
        if not bags:
            results = [run(rounds=rounds, duration_s=seconds or DURATION_S, report=say)]
        else:
            opened = _recordings(bags, vehicle, mapping, accept or [], msg_path, problems)
            results = [run_recorded(*one, rounds=rounds, report=say) for one in opened]
    figures = {'bags': [r.to_dict() for r in results]} if bags else results[0].to_dict()
    if as_json:
        emit_json({'ok': not problems, 'machine': facts, **figures})
    else:
        for result in results:
            _print_tables(result.tables())
        if results[0].peer is not None:
            sys.stdout.write(f'Same results: GTSAM within {results[0].agreement:.1g} sigma.\n')
        sys.stdout.write(_machine(facts, rounds))
    require(not problems)


def _recordings(
    bags: Sequence[Path],
    vehicle: str | None,
    mapping: Path | None,
    accept: Sequence[str],
    msg_path: Path | None,
    problems: list[object],
) -> Iterator[tuple[str, EngineParams, Inputs]]:
    """Recordings one by one; what is missing in them is said, and appended to ``problems``."""
    from ..analysis.opening import open_for
    from ..replay.recorded import choose_follower
    from ..smoothing.bag import mapped_inputs, recorded_inputs

    for path in bags:
        if mapping is None:
            bag = open_for(path, say)
            problems += bag.problems
            yield str(path), *recorded_inputs(bag, choose_follower(bag, vehicle)[0])
        else:
            source, what = open_mapped(path, mapping, {'configuration': 'default'}, msg_path)
            problems += source.problems
            yield str(path), *mapped_inputs(source, what, accept)


@bench.command(
    epilog='Example: `./polar bench graph`\n\n'
    'Quick look: `./polar bench graph --seconds 60 --rounds 1`'
)
def graph(
    rounds: Annotated[int, typer.Option(min=1, help='Rounds; ratios are their medians.')] = 3,
    seconds: Annotated[
        float, typer.Option(min=20.0, max=600.0, help='Simulated length of each run.')
    ] = 120.0,
    as_json: JsonOption = False,
) -> None:
    """Time the whole graph of the demo: a process per node, and one per vehicle (--composed).

    Processor time, wall time and memory of all processes. The followers have to publish the same
    bytes. On a shared machine only the ratios mean something, each taken within a round.
    """
    have_the_machine('measurements wait')
    from ..benchmarks.graph import run

    with _facts_of() as facts:
        result = run(rounds, seconds, report=say)
    if as_json:
        emit_json({'ok': True, 'machine': facts, **result.to_dict()})
        return
    _print_tables([result.table()])
    sys.stdout.write(
        'Same bytes of nav/state and nav/receipt in each round.\n' + _cores(facts, rounds)
    )


@bench.command(
    epilog='Example: `./polar bench endurance --folder bags/half_a_day`\n\n'
    'Quick look: `./polar bench endurance --hours 0.05`'
)
def endurance(
    hours: Annotated[
        float, typer.Option(min=0.02, max=48.0, help='Simulated length of the run.')
    ] = 12.0,
    mission: Annotated[
        str, typer.Option('--mission', '-m', metavar='NAME|FILE', help='What is sailed.')
    ] = 'demo',
    composed: Annotated[
        bool, typer.Option('--composed', help='Run the nodes of a vehicle in one process.')
    ] = False,
    max_bag_size: Annotated[
        int, typer.Option(metavar='MB', min=1, help='A file of the bag ends at this size.')
    ] = 64,
    folder: Annotated[
        Path | None,
        typer.Option(
            metavar='FOLDER',
            help='Where bag and logs are kept.',
            show_default='a temporary folder, deleted at the end',
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run a graph for half a day at full speed: memory of every node, and the bag verified.

    Exit status 1 when a node's memory in the last quarter of the run is more than 5 % above that
    in the second, when the bag is not whole, or when its replay differs from what ran live.
    """
    have_the_machine('measurements wait')
    from ..benchmarks.endurance import run

    place = TemporaryDirectory(prefix='polar_nav_') if folder is None else nullcontext(folder)
    with _facts_of() as facts, place as path:
        result = run(
            Path(path),
            hours=hours,
            mission=mission,
            composed=composed,
            max_bag_bytes=max_bag_size * 1_000_000,
            report=say,
        )
    if as_json:
        emit_json({'machine': facts, **result.to_dict()})
    else:
        _print_tables([result.table()])
        sys.stdout.write(f'{result.sentence()}\n{_cores(facts)}')
    if not result.ok:
        raise typer.Exit(1)


def _one_core(processor: int | None) -> int:
    """Wait for the machine; returns the core to which this process is bound from then on."""
    from ..benchmarks import machine

    have_the_machine('measurements wait')
    return machine.pin(processor)


@contextmanager
def _facts_of(
    distributions: Sequence[str] = (), core: int | None = None
) -> Iterator[dict[str, Any]]:
    """Facts of the machine and of versions, with the load before and after what is timed."""
    from ..benchmarks import machine

    facts: dict[str, Any] = {**machine.describe(distributions)}
    if core is not None:
        facts['core'] = core
    yield facts
    facts['load_average_after'] = machine.load()


def _print_tables(tables: Iterable[Table]) -> None:
    from rich.console import Console

    from ..terminal.tables import print_table

    console = Console(highlight=False)
    for table in tables:
        print_table(console, table)


def _machine(facts: Mapping[str, Any], rounds: int) -> str:
    """Return the line about the machine and versions of a measurement."""
    return (
        f'{facts["cpu"]}, core {facts["core"]} of {facts["cores"]}, load'
        f' {facts["load_average"]:.1f} to {facts["load_average_after"]:.1f}, Python'
        f' {facts["python"]}, '
        + ', '.join(f'{k} {v}' for k, v in facts['versions'].items())
        + f'; medians of {rounds} rounds.\n'
    )


def _cores(facts: Mapping[str, Any], rounds: int | None = None) -> str:
    """Return the line about the machine of a measurement on all its cores."""
    medians = '' if rounds is None else f'; medians of {rounds} rounds'
    return (
        f'{facts["cpu"]}, {facts["cores"]} cores, load {facts["load_average"]:.1f} to'
        f' {facts["load_average_after"]:.1f}, Python {facts["python"]}{medians}.\n'
    )
