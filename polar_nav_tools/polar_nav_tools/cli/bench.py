"""`polar bench`: measurements beside peers."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from polar_nav_core.errors import ConfigError

from .app import app, emit_json, have_the_machine, say
from .bench_facts import (
    CoreOption,
    JsonOption,
    cores_line,
    facts_of,
    machine_line,
    one_core,
    print_tables,
)

if TYPE_CHECKING:
    pass

bench = typer.Typer(
    no_args_is_help=True,
    help='Time what polar_nav does beside other programs that do the same work.',
    epilog='Example: `./polar bench core`',
)
app.add_typer(bench, name='bench')

_PICTURES = ('.svg', '.png', '.pdf')


BagsOption = Annotated[
    Path | None,
    typer.Option(
        '--folder',
        metavar='FOLDER',
        help='Where the bags are kept.',
        show_default='a folder among temporary files',
    ),
]


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
    used = one_core(processor)  # before anything numerical is loaded
    from ..benchmarks.core import DISTRIBUTIONS, run

    with facts_of(DISTRIBUTIONS, used) as facts:
        result = run(samples=samples, rounds=rounds, report=say)
    if as_json:
        emit_json({'ok': True, 'machine': facts, **result.to_dict()})
        return
    print_tables(group.table() for group in result.groups)
    worst = max(v for k, v in result.agreement_m.items() if 'horizontal' in k)
    covariance = max(result.agreement_covariance.values())
    sys.stdout.write(
        f'Same results: positions within {1e3 * worst:.1f} mm horizontally of python-ins after'
        f' {result.compared_samples} samples, covariances within {covariance:.0e}'
        ' of filterpy.\n' + machine_line(facts, rounds)
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
    used = one_core(processor)  # before anything numerical is loaded
    from ..benchmarks.delay import DISTRIBUTIONS, run

    with facts_of(DISTRIBUTIONS, used) as facts:
        result = run(rounds=rounds, run_s=seconds, report=say)
    if figure is not None:
        from ..benchmarks.delay_figure import write_figure

        write_figure(result, figure)
        say(f'picture: {figure}')
    if as_json:
        emit_json({'ok': True, 'machine': facts, **result.to_dict()})
        return
    print_tables(result.tables())
    sigma, peer = max(result.agreement_sigma.values()), max(result.agreement_peer.values())
    sys.stdout.write(
        f'Same results: clone within {sigma:.1g} sigma of rewind, Stone Soup within {peer:.0e}'
        ' sigma of both.\n' + machine_line(facts, rounds)
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
    used = one_core(processor)  # before anything numerical is loaded
    from ..benchmarks.replay import DISTRIBUTIONS, run

    with facts_of(DISTRIBUTIONS, used) as facts:
        result = run(hours=hours, rounds=rounds, report=say, folder=folder)
    if as_json:
        emit_json({'ok': True, 'machine': facts, **result.to_dict()})
        return
    print_tables(result.tables())
    compared = ', '.join(f'{name} {count}' for name, count in result.agreement.items())
    sys.stdout.write(
        f'Same bits, values compared: {compared}.\n'
        f'{result.real_time:.0f} times real time; others scaled from {result.part_minutes:g} min;'
        f' peak memory {result.peak_mb:.0f} MB.\n' + machine_line(facts, rounds)
    )


@bench.command(
    name='monte-carlo',
    epilog='Example: `./polar bench monte-carlo`\n\n'
    'Quick look: `./polar bench monte-carlo --hours 0.5 --rounds 1`',
)
def monte_carlo(
    hours: Annotated[float, typer.Option(min=0.05, max=24.0, help='Length of the run.')] = 12.0,
    rounds: Annotated[int, typer.Option(min=1, help='Rounds; times are their medians.')] = 5,
    processor: CoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Time a run of arrays, as campaigns make them, with looks of the watchdog and without.

    Estimates are not kept. Times are processor times on one core.
    """
    used = one_core(processor)  # before anything numerical is loaded
    from ..benchmarks.monte_carlo import DISTRIBUTIONS, run

    with facts_of(DISTRIBUTIONS, used) as facts:
        result = run(hours=hours, rounds=rounds, report=say)
    if as_json:
        emit_json({'ok': True, 'machine': facts, **result.to_dict()})
        return
    print_tables([result.table()])
    sys.stdout.write(f'{result.fused} fixes used.\n' + machine_line(facts, rounds))


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
        print_tables([table(hours, found)])
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

    with facts_of() as facts:
        found = run(rate or RATES, seconds, report=say)
    if as_json:
        emit_json({'machine': facts, 'rates': [asdict(one) for one in found]})
        return
    print_tables([table(found)])
    sys.stdout.write(cores_line(facts))


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

    with facts_of() as facts:
        result = run(rounds, seconds, report=say)
    if as_json:
        emit_json({'ok': True, 'machine': facts, **result.to_dict()})
        return
    print_tables([result.table()])
    sys.stdout.write(
        'Same bytes of nav/state and nav/receipt in each round.\n' + cores_line(facts, rounds)
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
    with facts_of() as facts, place as path:
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
        print_tables([result.table()])
        sys.stdout.write(f'{result.sentence()}\n{cores_line(facts)}')
    if not result.ok:
        raise typer.Exit(1)
