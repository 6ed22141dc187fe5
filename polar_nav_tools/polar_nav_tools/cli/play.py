"""`polar play`: a recording as a live graph."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from polar_nav_core.errors import ConfigError

from . import status
from .app import app, emit_json, end, require, say
from .arguments import AnyBagArgument, MsgPathOption

if TYPE_CHECKING:
    from ..play.run import Played


@app.command(
    epilog='Example: `./polar play bags/my_run --inputs --wait /follower/follower_node`'
    '\n\nHalf as fast, in simulated time, again and again: '
    '`./polar play cruise.bag --rate 0.5 --clock 100 --loop`'
)
def play(
    bag: AnyBagArgument,
    topics: Annotated[
        list[str] | None,
        typer.Option('--topics', metavar='A,B', help='Only these; * stands for anything.'),
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option('--exclude', metavar='A,B', help='All but these.')
    ] = None,
    inputs: Annotated[
        bool,
        typer.Option('--inputs', help='Without what vehicles computed: nav/..., odometry.'),
    ] = False,
    remap: Annotated[
        list[str] | None,
        typer.Option('--remap', metavar='OLD:=NEW', help='Another name of a topic; repeatable.'),
    ] = None,
    namespace: Annotated[str, typer.Option('--namespace', help='Before all other names.')] = '',
    rate: Annotated[float, typer.Option('--rate', '-r', help='Times the recorded speed.')] = 1.0,
    clock: Annotated[
        float | None,
        typer.Option('--clock', metavar='HZ', help='Publish /clock from log times, so often.'),
    ] = None,
    start: Annotated[
        float, typer.Option('--start', metavar='S', min=0.0, help='Seconds to pass over.')
    ] = 0.0,
    duration: Annotated[
        float | None,
        typer.Option('--duration', '-d', metavar='S', min=0.0, help='Seconds of the recording.'),
    ] = None,
    loop: Annotated[bool, typer.Option('--loop', help='Again and again, until Ctrl-C.')] = False,
    wait: Annotated[
        list[str] | None,
        typer.Option('--wait', metavar='any|A,B', help='Begin when these nodes or topics listen.'),
    ] = None,
    wait_s: Annotated[
        float, typer.Option('--wait-s', metavar='S', min=0.0, help='Longest wait for them.')
    ] = 30.0,
    no_build: Annotated[
        bool, typer.Option('--no-build', help='Do not build message types that are not here.')
    ] = False,
    network: Annotated[
        bool,
        typer.Option('--network', help='Let other hosts hear it; docs/security.md has the risks.'),
    ] = False,
    msg_path: MsgPathOption = None,
    as_json: Annotated[
        bool, typer.Option('--json', help='Print figures as JSON on stdout.')
    ] = False,
) -> None:
    """Publish the topics of a bag again, as they were recorded: types, QoS, order and pace.

    Types that are not installed are built from the definitions in the bag. Uses the ROS domain of
    the shell (ROS_DOMAIN_ID, 0 when it is not set). Only this host hears it, unless --network is
    given.
    """
    from ..foreign.sources import open_source
    from ..play.run import Options
    from ..play.run import play as run_play
    from ..play.selection import Selection, parse_remaps, split_names
    from ..terminal.progress import opening_display

    _require_positive('--rate', rate)
    if clock is not None:
        _require_positive('--clock', clock)
    options = Options(
        selection=Selection(
            topics=split_names(topics or []),
            exclude=split_names(exclude or []),
            inputs=inputs,
            remap=parse_remaps(remap or []),
            namespace=namespace,
            clock=clock is not None,
        ),
        rate=rate,
        clock_hz=clock,
        loop=loop,
        start_s=start,
        duration_s=duration,
        wait=None if wait is None else split_names(wait),
        wait_s=wait_s,
        build=not no_build,
        network=network,
    )
    with opening_display(bag) as progress:
        source = open_source(bag, progress, msg_path=msg_path)
    for problem in source.problems:
        say(f'{bag}: {problem}')
    with _progress() as shown:
        played = run_play(source, options, say, shown)
    complaints = played.complaints()
    well = not (source.problems or complaints)
    if as_json:
        emit_json({'ok': well, 'path': str(bag), **played.to_dict()})
    else:
        _print(played)
    for sentence in (*complaints, played.remark()):
        if sentence is not None:
            say(sentence)
    # Ctrl-C is the usual end of what has no other.
    if played.signal is not None and not (loop and played.signal == signal.SIGINT):
        say(f'ended by {signal.Signals(played.signal).name}')
        end(status.of_signal(played.signal))
    require(well)


def _print(played: Played) -> None:
    for track in played.tracks.playable:
        other = '' if track.published == track.name else f', as {track.published}'
        count = played.published.get(track.name, 0)
        sys.stdout.write(f'{track.name}: {count} messages, {track.offer.words()}{other}\n')
    for package, prefix in sorted(played.tracks.built.items()):
        sys.stdout.write(f'{package}: for other nodes, `source {prefix / "environment.sh"}`\n')
    values = played.to_dict()
    sys.stdout.write(
        f'{values["messages"]} messages of {values["recorded_s"]:.3f} s in '
        f'{played.wall_s:.3f} s; lag {1e3 * played.lag.largest_ns / 1e9:.1f} ms at most\n'
    )


def _require_positive(option: str, value: float) -> None:
    if not 1e-3 <= value <= 1e4:
        raise ConfigError(f'{option} {value:g} is not within 0.001 and 10000')


@contextmanager
def _progress() -> Iterator[Callable[[float, float], None] | None]:
    """Show how far a playback is, on a terminal only."""
    from ..terminal.progress import progress_display

    if not sys.stderr.isatty():
        yield None
        return
    with progress_display('playing', total=1.0, unit='s') as update:
        yield update
