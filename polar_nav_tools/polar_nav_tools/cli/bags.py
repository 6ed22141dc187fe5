"""`polar replay`, `verify`, `score`, `report`, `info`, `recover`: commands on a recorded bag.

A bag with something missing is read as far as it goes: the command says what is missing, gives its
figures, and ends with status 1.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, end, say

if TYPE_CHECKING:
    from ..analysis import Analysis
    from ..bags import Bag

BagArgument = Annotated[
    Path,
    typer.Argument(metavar='BAG', help='Folder of a bag, or an .mcap file.', show_default=False),
]
ConfigurationsOption = Annotated[
    list[str] | None,
    typer.Option('--configuration', '-c', help='Filter configuration; may be repeated.'),
]
VehicleOption = Annotated[
    str | None, typer.Option('--vehicle', help='Which follower, when the bag has several.')
]
TruthOption = Annotated[
    Path | None, typer.Option('--truth', help='Another bag with the truth.', show_default=False)
]
JsonOption = Annotated[bool, typer.Option('--json', help='Print figures as JSON on stdout.')]

DEMO_PAIR = ('conventional_akf', 'modified_akf')


@app.command(
    epilog='Example: `./polar replay bags/my_run -c conventional_akf --out bags/conventional`'
    '\n\nOther parameters: `./polar replay bags/my_run --set max_delay_s=10.0`'
)
def replay(
    bag: BagArgument,
    configuration: Annotated[
        str | None,
        typer.Option(
            '--configuration', '-c', help='Filter configuration instead of the recorded.'
        ),
    ] = None,
    change: Annotated[
        list[str] | None,
        typer.Option('--set', metavar='NAME=VALUE', help='Change a follower parameter.'),
    ] = None,
    out: Annotated[
        Path | None, typer.Option('--out', '-o', help='Folder of a new bag for the estimates.')
    ] = None,
    vehicle: VehicleOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run the messages of a bag through the follower's filter again.

    The same engine as in the live node, on the same bytes: with the recorded parameters it gives
    the recorded estimates.
    """
    from ..replay import replay as run_replay
    from ..replay_bag import parse_changes, replay_summary, write_replay

    changes = parse_changes(change or [])
    if out is not None and out.exists():
        raise typer.BadParameter(f'{out} exists already; a bag is never overwritten')
    with _opened(bag) as source:
        with _percent('replay') as progress:
            result = run_replay(
                source,
                configuration=configuration,
                vehicle=vehicle,
                changes=changes,
                progress=progress,
            )
        summary = replay_summary(result)
        if out is not None:
            write_replay(out, result, source)
            summary['bag'] = str(out)
        if as_json:
            emit_json({'ok': not (source.problems or result.divergence), **summary})
        else:
            for name, value in summary.items():
                sys.stdout.write(f'{name:>14}: {_plain(value)}\n')
        if result.divergence:
            say(f'the filter diverged: {result.divergence}')
            end(1)


@app.command(epilog='Example: `./polar verify bags/my_run`')
def verify(bag: BagArgument, vehicle: VehicleOption = None, as_json: JsonOption = False) -> None:
    """Compare the recorded estimates with a replay, bit for bit."""
    from ..verification import verify as run_verify

    with _opened(bag) as source:
        with _percent('replay') as progress:
            result = run_verify(source, vehicle=vehicle, progress=progress)
        if as_json:
            topics = {
                topic: {
                    'live_sha256': result.live_sha256[topic],
                    'replay_sha256': result.replay_sha256[topic],
                    'live_messages': result.counts[topic][0],
                    'replayed_messages': result.counts[topic][1],
                }
                for topic in result.live_sha256
            }
            difference = str(result.difference) if result.difference else None
            emit_json(
                {
                    'ok': result.equal and not source.problems,
                    'equal': result.equal,
                    'vehicle': result.vehicle,
                    'topics': topics,
                    'first_difference': difference,
                }
            )
        else:
            for topic, digest in result.live_sha256.items():
                live, replayed = result.counts[topic]
                sys.stdout.write(f'/{result.vehicle}/{topic}\n')
                sys.stdout.write(f'  live   {live:>7} messages, sha256 {digest}\n')
                other = result.replay_sha256[topic]
                sys.stdout.write(f'  replay {replayed:>7} messages, sha256 {other}\n')
            if result.equal:
                sys.stdout.write('equal, bit for bit\n')
        if not result.equal:
            say(f'live and replay differ: {result.difference}')
            end(1)


@app.command(
    epilog='Example: `./polar score bags/my_run`'
    '\n\nOnly what was recorded live: `./polar score bags/my_run --recorded`'
)
def score(
    bag: BagArgument,
    configuration: ConfigurationsOption = None,
    recorded: Annotated[
        bool, typer.Option('--recorded', help='Score the recorded estimates and replay nothing.')
    ] = False,
    truth: TruthOption = None,
    vehicle: VehicleOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare estimates with the truth: errors, what the delay costs, honesty of the covariance.

    Replays the bag with both filters of the paper, or with the configurations that are named.
    """
    with _opened(bag) as source:
        analysis = _analysed(source, configuration, recorded, truth, vehicle)
        if as_json:
            emit_json(
                {
                    'ok': not analysis.complaints(),
                    'vehicle': analysis.vehicle,
                    'runs': analysis.comparison.to_dict(),
                    'packets': None if analysis.delivery is None else analysis.delivery.to_dict(),
                    'complaints': analysis.complaints(),
                }
            )
        else:
            from rich.console import Console

            from ..scoring.delivery import delivery_table
            from ..terminal import print_table

            console = Console(highlight=False)
            for table in analysis.comparison.tables():
                print_table(console, table)
            if analysis.delivery is not None:
                print_table(console, delivery_table(analysis.delivery))
        _end_with(analysis)


@app.command(epilog='Example: `./polar report bags/my_run --open`')
def report(
    bag: BagArgument,
    out: Annotated[
        Path | None, typer.Option('--out', '-o', help='HTML file; by default in the bag.')
    ] = None,
    configuration: ConfigurationsOption = None,
    recorded: Annotated[
        bool, typer.Option('--recorded', help='Show the recorded estimates and replay nothing.')
    ] = False,
    truth: TruthOption = None,
    vehicle: VehicleOption = None,
    open_report: Annotated[bool, typer.Option('--open', help='Open it in a browser.')] = False,
    as_json: JsonOption = False,
) -> None:
    """Draw a bag: track on a polar map, errors with 3-sigma bands, delay and fate of each fix."""
    from ..drawing import write_analysis

    with _opened(bag) as source:
        analysis = _analysed(source, configuration, recorded, truth, vehicle)
        folder = bag if bag.is_dir() else bag.parent
        path = write_analysis(analysis, out or folder / 'report.html')
        if as_json:
            emit_json({'ok': not analysis.complaints(), 'report': str(path)})
        else:
            sys.stdout.write(f'{path}\n')
        if open_report:
            typer.launch(str(path))
        _end_with(analysis)


@app.command(epilog='Example: `./polar info bags/my_run --json`')
def info(bag: BagArgument, as_json: JsonOption = False) -> None:
    """Say what is in a bag: topics, counts, rates, the run it is of, and what is missing."""
    from ..bags.info import bag_info

    with _opened(bag) as source:
        facts = bag_info(source)
        if as_json:
            from ..scoring.plain import jsonable

            said = {name: jsonable(value) for name, value in facts.to_dict().items()}
            emit_json({'ok': facts.is_complete, **said})
        else:
            from ..terminal import print_info

            print_info(facts)


@app.command(epilog='Example: `./polar recover bags/broken --out bags/mended`')
def recover(
    bag: BagArgument,
    out: Annotated[
        Path | None,
        typer.Option('--out', '-o', help='Folder of the new bag; BAG_recovered by default.'),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a whole bag of a broken one, with everything that can be read, for all other tools."""
    from ..bags.recover import recover as run_recover

    stem = bag.parent if bag.is_file() and (bag.parent / 'metadata.yaml').exists() else bag
    target = out or stem.with_name(f'{stem.name.removesuffix(".mcap")}_recovered')
    result = run_recover(bag, target)
    if as_json:
        emit_json({'ok': True, **result.to_dict()})
        return
    for problem in result.problems:
        say(problem)
    sys.stdout.write(f'{result.target}: {result.message_count} messages\n')


@contextmanager
def _opened(path: Path) -> Iterator[Bag]:
    """Open a bag for one command; status 1 at its end when something is missing in the bag."""
    from ..analysis import open_for

    bag = open_for(path, say)
    yield bag
    if bag.problems:
        end(1)


@contextmanager
def _percent(what: str) -> Iterator[Callable[[float], None]]:
    from ..progress import progress_display

    with progress_display(what, total=100.0, unit='%') as update:
        yield lambda share: update(100.0 * share, 100.0)


def _analysed(
    bag: Bag,
    configurations: list[str] | None,
    recorded: bool,
    truth: Path | None,
    vehicle: str | None,
) -> Analysis:
    from ..analysis import analyse, open_for

    chosen = () if recorded else tuple(configurations or DEMO_PAIR)
    return analyse(
        bag,
        chosen,
        vehicle=vehicle,
        live=recorded,
        truth_from=None if truth is None else open_for(truth, say),
        say=say,
    )


def _end_with(analysis: Analysis) -> None:
    complaints = analysis.complaints()
    for complaint in complaints[len(analysis.bag.problems) :]:
        say(complaint)
    if complaints:
        end(1)


def _plain(value: object) -> str:
    if isinstance(value, dict):
        return ', '.join(f'{k} {_plain(v)}' for k, v in value.items()) or 'none'
    return str(value)
