"""`polar demo`, `polar launch`, `polar record`: commands that start nodes."""

from __future__ import annotations

import json
import signal
from datetime import datetime
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Annotated

import typer

from polar_nav_core.errors import ConfigError

from . import status
from .app import app, emit_json, end, have_the_machine, require, say
from .choices import CONFIGURATIONS, LEADERS, MISSIONS, PACES, one_of

if TYPE_CHECKING:
    from ..graph.build import Graph

BAGS = Path('bags')

MissionOption = Annotated[
    str,
    typer.Option('--mission', '-m', metavar='NAME|FILE', help=f'{MISSIONS}; or a YAML file.'),
]
DurationOption = Annotated[
    float | None,
    typer.Option('--duration', '-d', help='Simulated seconds; the mission knows its own.'),
]
SeedOption = Annotated[
    int,
    typer.Option('--seed', min=0, help='Seed of the run; every random stream is made from it.'),
]
ConfigurationOption = Annotated[
    str | None,
    typer.Option(
        '--configuration',
        '-c',
        metavar='NAME',
        help=f'Of the follower; `default` unless stated: {", ".join(CONFIGURATIONS)}.',
    ),
]
BagOption = Annotated[
    Path | None,
    typer.Option('--bag', help='Folder of the new bag; by default a new one in bags/.'),
]
AsRecordedOption = Annotated[
    bool,
    typer.Option(
        '--as-recorded', help='Sail a recorded track with its own stamps, as it drifted.'
    ),
]
LeaderOption = Annotated[
    str,
    typer.Option(
        '--leader',
        metavar=one_of(LEADERS),
        help='perfect: knows its position, as the papers assume; own: it navigates.',
    ),
]
NetworkOption = Annotated[
    bool,
    typer.Option(
        '--network', help='Let other hosts see the graph; docs/security.md has the risks.'
    ),
]
ComposedOption = Annotated[
    bool,
    typer.Option(
        '--composed',
        help='Run the nodes of a vehicle in one process: less memory, a faster start.',
    ),
]
JsonOption = Annotated[bool, typer.Option('--json', help='Print figures as JSON on stdout.')]


@app.command(
    epilog='Example: `./polar demo --duration 120`'
    '\n\nNear the pole: `./polar demo --mission near_pole --open`'
)
def demo(
    mission: MissionOption = 'demo',
    duration: DurationOption = None,
    seed: SeedOption = 1,
    pace: Annotated[
        str,
        typer.Option(
            metavar=one_of(PACES),
            help='lockstep loses nothing and is fast; realtime waits for no node.',
        ),
    ] = 'lockstep',
    configuration: ConfigurationOption = None,
    bag: BagOption = None,
    as_recorded: AsRecordedOption = False,
    leader: LeaderOption = 'perfect',
    network: NetworkOption = False,
    composed: ComposedOption = False,
    open_report: Annotated[
        bool, typer.Option('--open', help='Open the report in a browser at the end.')
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run the whole graph, record it, replay, verify, score, report.

    Real nodes as processes over the real middleware, in simulated time. The recorded bag is
    replayed with the conventional filter, which takes late fixes as current, and with the
    delay-aware one, and both are scored against the truth. With `--mission station` it is replayed
    with the published filter, which takes current and drag as known, and with the one that
    estimates them.
    """
    from ..demo import DemoOptions, run_demo

    options = DemoOptions(
        mission=mission,
        duration_s=duration,
        seed=seed,
        pace=pace,
        configuration=configuration,
        bag=bag,
        folder=BAGS,
        as_recorded=as_recorded,
        leader=leader,
        network=network,
        composed=composed,
    )
    have_the_machine('demo waits')  # nodes that compile or wait do not answer meanwhile
    result = run_demo(options, say=say)
    if result.signal is not None:
        say(f'ended by {signal.Signals(result.signal).name}; the bag is {result.run.bag}')
        end(status.of_signal(result.signal))
    if as_json:
        emit_json(result.to_dict())
    else:
        result.print_tables()
    if open_report and result.report is not None:
        typer.launch(str(result.report))
    for complaint in result.complaints:
        say(complaint)
    for remark in result.analysis.remarks() if result.analysis is not None else ():
        say(f'beside it, {remark}')
    require(not result.complaints)


@app.command(epilog='Example: `./polar launch --duration 300`, and elsewhere `ros2 topic list`')
def launch(
    mission: MissionOption = 'demo',
    duration: DurationOption = None,
    seed: SeedOption = 1,
    configuration: ConfigurationOption = None,
    bag: BagOption = None,
    as_recorded: AsRecordedOption = False,
    leader: LeaderOption = 'perfect',
    network: NetworkOption = False,
    composed: ComposedOption = False,
    no_record: Annotated[
        bool, typer.Option('--no-record', help='Run without a recorder.')
    ] = False,
) -> None:
    """Run the graph in real time until the mission ends or Ctrl-C, to be looked at with ROS tools.

    Uses the ROS domain of the shell (ROS_DOMAIN_ID, 0 when it is not set). Only this host sees it,
    unless --network is given.
    """
    from ..graph.options import USUAL_CONFIGURATION, WATCHED_REORDER_S, GraphOptions
    from ..live.run import new_bag_path, read_mission, run_live
    from ..terminal.progress import progress_display

    chosen = read_mission(mission, duration, as_recorded=as_recorded)
    named = bag or new_bag_path(BAGS, chosen.name, seed, datetime.now())
    target = None if no_record else named
    options = GraphOptions(
        pace='realtime',
        respawn=True,
        seed=seed,
        configuration=configuration or USUAL_CONFIGURATION,
        leader=leader,
        bag=target,
        reorder_s=WATCHED_REORDER_S,
        composed=composed,
    )
    have_the_machine('launch waits')
    folder = Path(mkdtemp(prefix='polar_nav_')) if target is None else target
    with progress_display(chosen.name, total=chosen.duration_s, unit='s') as on_progress:
        run = run_live(
            chosen,
            options,
            folder,
            own_domain=False,
            network=network,
            on_start=_tell_start,
            on_progress=on_progress,
            on_line=lambda name, line: say(f'{name}: {line}'),
            on_problem=say,
        )
    say(f'bag: {run.bag}' if run.bag else f'logs: {run.folder}')
    run.check()
    if run.outcome.culprit is not None:
        say(f'{run.outcome.culprit.title} {run.outcome.culprit.how()} while it was ended')
        end(status.NOT_WELL)


@app.command(
    epilog='Example: `./polar record --out bags/my_run`'
    '\n\nAfter a break: `./polar record --out bags/my_run --resume`'
)
def record(
    out: Annotated[Path | None, typer.Option('--out', '-o', help='Folder of the new bag.')] = None,
    max_bag_size: Annotated[
        int, typer.Option(min=0, help='Bytes of a file, then comes a next one; 0: one file.')
    ] = 0,
    max_bag_duration: Annotated[
        float, typer.Option(min=0.0, help='Seconds in a file, then comes a next one; 0: any.')
    ] = 0.0,
    resume: Annotated[
        bool, typer.Option('--resume', help='Go on with the bag of --out, in a next file of it.')
    ] = False,
) -> None:
    """Record every topic of the running graph into an MCAP bag until Ctrl-C.

    Uses the ROS domain of the shell (ROS_DOMAIN_ID, 0 when it is not set).
    """
    from ..live.run import new_bag_path

    if resume and out is None:
        raise typer.BadParameter('--resume needs --out, the bag to go on with')
    target = out or new_bag_path(BAGS, 'recording', 0, datetime.now())
    if not resume and target.exists():
        raise ConfigError(f'{target} exists already; --resume goes on with it')
    if resume:
        from ..bags.resuming import require_bag

        for remark in require_bag(target):
            say(remark)
    from ..record.recorder_node import main as recorder_main

    say(f'recording to {target}; Ctrl-C ends it')
    # In quotes: a parameter on the command line is YAML, where 2026 would be a number.
    values = {
        'output': json.dumps(str(target)),
        'max_bag_size': max_bag_size,
        'max_bag_duration': max_bag_duration,
        'resume': json.dumps(resume),
    }
    given = [part for name, value in values.items() for part in ('-p', f'{name}:={value}')]
    end(recorder_main(['--ros-args', *given]))


def _tell_start(graph: Graph, domain_id: str) -> None:
    say(f'{len(graph.nodes)} nodes in ROS domain {domain_id}')
