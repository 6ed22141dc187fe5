"""`polar replay`, `report`, `info`, `recover`: commands on a recorded bag.

A bag with something missing is read as far as it goes: the command says what is missing, gives its
figures, and ends with status 1.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, require, say
from .arguments import (
    AcceptOption,
    AnyBagArgument,
    ChangeOption,
    MapOption,
    MsgPathOption,
    existing,
)
from .choices import CONFIGURATIONS

if TYPE_CHECKING:
    from ..analysis.analyse import Analysis
    from ..bags import Bag
    from ..bags.ahead import Wants
    from ..bags.request import Request
    from ..foreign.sources import Source

BagArgument = Annotated[
    Path,
    typer.Argument(
        metavar='BAG',
        help='Folder of a bag, or an .mcap file; also s3:// or https://.',
        show_default=False,
        callback=existing,
    ),
]
ConfigurationsOption = Annotated[
    list[str] | None,
    typer.Option(
        '--configuration',
        '-c',
        metavar='NAME',
        help=f'May be repeated: {", ".join(CONFIGURATIONS)}.',
    ),
]
SmoothOption = Annotated[
    bool,
    typer.Option('--smooth', help='Show the smoother beside: each place by all measurements.'),
]
VehicleOption = Annotated[
    str | None, typer.Option('--vehicle', help='Which follower, when the bag has several.')
]
TruthOption = Annotated[
    Path | None, typer.Option('--truth', help='Another bag with the truth.', show_default=False)
]
JsonOption = Annotated[bool, typer.Option('--json', help='Print figures as JSON on stdout.')]

_LONG = 500_000
"""Messages from which a score shows how far it is."""


@app.command(
    epilog='Example: `./polar replay bags/my_run -c conventional_akf --out bags/conventional`'
    '\n\nOther parameters: `./polar replay bags/my_run --set max_delay_s=10.0`'
    '\n\nA bag of any origin: `./polar replay cruise.bag --map mapping.yaml`'
)
def replay(
    bag: BagArgument,
    configuration: Annotated[
        str | None,
        typer.Option(
            '--configuration',
            '-c',
            metavar='NAME',
            help=f'Instead of the recorded one: {", ".join(CONFIGURATIONS)}.',
        ),
    ] = None,
    change: ChangeOption = None,
    out: Annotated[
        Path | None, typer.Option('--out', '-o', help='Folder of a new bag for the estimates.')
    ] = None,
    vehicle: VehicleOption = None,
    mapping: MapOption = None,
    accept: AcceptOption = None,
    msg_path: MsgPathOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run the messages of a bag through the follower's filter again.

    The same engine as in the live node, on the same bytes: with the recorded parameters it gives
    the recorded estimates. Hashes of the messages are printed with --out, which makes them. With
    --map, a bag of any origin: MCAP, sqlite3 or ROS 1.
    """
    if mapping is not None:
        from .foreign import replay_foreign

        stated, taken = change or [], accept or []
        replay_foreign(bag, mapping, configuration, stated, taken, out, msg_path, as_json)
        return
    if msg_path is not None:
        raise typer.BadParameter('goes with --map', param_hint='--msg-path')
    from polar_nav_core.engine.health.span import span_of_health

    from ..replay.arrays_from_bag import arrays_request
    from ..replay.by_array import replay_estimates
    from ..replay.by_message import ReplayResult
    from ..replay.by_message import replay as run_replay
    from ..replay.output import parse_changes, replay_summary, write_replay
    from ..replay.recorded import choose_description
    from ..replay.result import ReplayedRun

    changes = parse_changes(change or [])
    if out is not None and out.exists():
        raise typer.BadParameter(f'{out} exists already; a bag is never overwritten')

    def wants(found: Bag) -> Request | None:
        return arrays_request(found, vehicle)

    with opened(bag, wants if out is None else None) as source:
        with percent('replay') as progress:
            chosen = (configuration, vehicle, changes, progress)
            result: ReplayResult | ReplayedRun | None = None
            if out is None:
                result = replay_estimates(source, *chosen)
            if result is None:  # messages are wanted, or the only way
                result = run_replay(
                    source,
                    configuration=configuration,
                    vehicle=vehicle,
                    changes=changes,
                    progress=progress,
                )
        summary = replay_summary(result, choose_description(source, vehicle)[1])
        span = span_of_health(result.health)
        if out is not None and isinstance(result, ReplayResult):
            write_replay(out, result, source)
            summary['written'] = str(out)
        if as_json:
            well = not (source.problems or result.divergence or span.complaint)
            emit_json({'ok': well, 'path': str(source.path), **summary})
        else:
            for name, value in summary.items():
                first, *others = value if isinstance(value, list) and value else [_plain(value)]
                sys.stdout.write(f'{name:>18}: {first}\n')
                sys.stdout.writelines(f'{"":>20}{other}\n' for other in others)
        if result.divergence:
            say(f'the filter diverged: {result.divergence}')
        if span.complaint or span.remark:
            say(span.complaint or span.remark)
        require(not (result.divergence or span.complaint))


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
    smooth: SmoothOption = False,
    truth: TruthOption = None,
    vehicle: VehicleOption = None,
    open_report: Annotated[bool, typer.Option('--open', help='Open it in a browser.')] = False,
    as_json: JsonOption = False,
) -> None:
    """Draw a bag: track on a polar map, errors with 3-sigma bands, delay and fate of each fix."""
    _require_out(bag, out)
    from ..analysis.html_report import write_analysis

    with opened(bag, ahead_of(recorded, truth, vehicle)) as source:
        analysis = analysed(source, configuration, recorded, truth, vehicle, smooth)
        folder = bag if bag.is_dir() else bag.parent
        path = write_analysis(analysis, out or folder / 'report.html')
        if as_json:
            said = {'ok': not analysis.complaints(), 'path': str(bag)}
            emit_json({**said, 'report': str(path)})
        else:
            sys.stdout.write(f'{path}\n')
        if open_report:
            typer.launch(str(path))
        require(print_complaints(analysis))


@app.command(epilog='Example: `./polar info bags/my_run --json`')
def info(bag: AnyBagArgument, msg_path: MsgPathOption = None, as_json: JsonOption = False) -> None:
    """Show the contents of a bag: topics, counts, rates, its run, and missing parts."""
    from ..bags.info import bag_info
    from ..foreign.definitions import undecodable
    from ..foreign.info import source_info
    from ..foreign.sources import not_described
    from ..foreign.sources.mcap import McapSource

    with opened_source(bag, msg_path) as source:
        facts = bag_info(source.bag) if isinstance(source, McapSource) else source_info(source)
        missing = not_described(source)
        if as_json:
            from ..scoring.json_values import jsonable

            said = {name: jsonable(value) for name, value in facts.to_dict().items()}
            emit_json({'ok': facts.is_complete, **said, 'not_described': list(missing)})
        else:
            from ..terminal.tables import print_info

            print_info(facts)
        sentence = undecodable(missing)
        if sentence is not None:
            say(f'{bag}: {sentence}')


@app.command(epilog='Example: `./polar recover bags/broken --out bags/mended`')
def recover(
    bag: BagArgument,
    out: Annotated[
        Path | None,
        typer.Option('--out', '-o', help='Folder of the new bag; BAG_recovered by default.'),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a complete bag from a broken one, with all messages that can be read."""
    from ..bags.recover import recover as run_recover
    from ..terminal.progress import opening_display

    _require_out(bag, out)
    stem = bag.parent if bag.is_file() and (bag.parent / 'metadata.yaml').exists() else bag
    target = out or stem.with_name(f'{stem.name.removesuffix(".mcap")}_recovered')
    with opening_display(bag) as progress:
        result = run_recover(bag, target, progress)
    if as_json:
        emit_json({'ok': True, **result.to_dict()})
        return
    for problem in result.problems:
        say(problem)
    sys.stdout.write(f'{result.target}: {result.message_count} messages\n')


def _require_out(bag: Path, out: Path | None) -> None:
    """Raise BadParameter where nothing can be written beside a bag, which is at an address."""
    from ..bags.remote.address import is_remote

    if out is None and is_remote(bag):
        raise typer.BadParameter(f'{bag} cannot be written to: say where', param_hint='--out')


@contextmanager
def opened(path: Path, ahead: Wants | None = None, *, whole: bool = False) -> Iterator[Bag]:
    """Open a bag for one command; status 1 at its end when something is missing in the bag."""
    from ..analysis.opening import open_for

    bag = open_for(path, say, ahead, whole=whole)
    yield bag
    require(not bag.problems)


@contextmanager
def opened_source(path: Path, msg_path: Path | None) -> Iterator[Source]:
    """Open a bag of any kind for one command, as `opened`."""
    from ..foreign.sources import open_source
    from ..foreign.sources.mcap import McapSource
    from ..terminal.progress import opening_display

    with opening_display(path) as progress:
        source = open_source(path, progress, msg_path=msg_path)
    if isinstance(source, McapSource):
        for remark in source.bag.remarks:
            say(remark)
    for problem in source.problems:
        say(f'{path}: {problem}')
    yield source
    require(not source.problems)


@contextmanager
def percent(what: str) -> Iterator[Callable[[float], None]]:
    """Show a progress display; yields a callback for the share that is done, 0 to 1."""
    from ..terminal.progress import progress_display

    with progress_display(what, total=100.0, unit='%') as update:
        yield lambda share: update(100.0 * share, 100.0)


def analysed(
    bag: Bag,
    configurations: list[str] | None,
    recorded: bool,
    truth: Path | None,
    vehicle: str | None,
    smooth: bool = False,
) -> Analysis:
    """Replay and score a bag as the options of `score` and `report` say."""
    from ..analysis.analyse import analyse
    from ..analysis.opening import open_for

    chosen = () if recorded else tuple(configurations or _usual_filters(bag, vehicle))
    long = (bool(chosen) or smooth) and bag.message_count >= _LONG
    with percent('replay') if long else nullcontext(None) as progress:
        return analyse(
            bag,
            chosen,
            vehicle=vehicle,
            live=recorded,
            smooth=smooth,
            judge_live=recorded or not configurations,
            truth_from=None if truth is None else open_for(truth, say),
            say=say,
            progress=progress,
        )


def ahead_of(recorded: bool, truth: Path | None, vehicle: str | None) -> Wants | None:
    """Topics that `analysed` reads with these options, for `open_for`."""
    from ..analysis.opening import wanted_of

    return None if recorded else wanted_of(vehicle, truth=truth is None)


def _usual_filters(bag: Bag, vehicle: str | None) -> tuple[str, ...]:
    """Names of the configurations compared by default, in the mode of the bag's follower."""
    from polar_nav_core.engine.configurations import WITH_LEADER, compared_of

    from ..replay.recorded import followers_of

    found = followers_of(bag)
    chosen = found.get(vehicle) if vehicle is not None else next(iter(found.values()), None)
    return WITH_LEADER if chosen is None else compared_of(chosen)


def print_complaints(analysis: Analysis) -> bool:
    """Print complaints not yet printed for the bag; returns True if there are none at all."""
    complaints = analysis.complaints()
    for complaint in complaints[len(analysis.bag.problems) :]:
        say(complaint)
    for remark in analysis.remarks():
        say(f'beside it, {remark}')
    return not complaints


def _plain(value: object) -> str:
    if isinstance(value, dict):
        return ', '.join(f'{k} {_plain(v)}' for k, v in value.items()) or 'none'
    return 'none' if value == [] else str(value)
