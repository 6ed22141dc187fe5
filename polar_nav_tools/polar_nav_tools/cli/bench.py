"""`polar bench`: measurements beside peers."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from .app import app, emit_json, say

bench = typer.Typer(
    no_args_is_help=True,
    help='Time what polar_nav does beside other programs that do the same work.',
    epilog='Example: `./polar bench core`',
)
app.add_typer(bench, name='bench')


@bench.command(
    epilog='Example: `./polar bench core`\n\nQuick look: `./polar bench core --rounds 1`'
)
def core(
    rounds: Annotated[int, typer.Option(min=1, help='Rounds; ratios are their medians.')] = 7,
    samples: Annotated[
        int, typer.Option(min=1, max=360_000, help='IMU samples in the record, 100 per second.')
    ] = 60_000,
    processor: Annotated[
        int | None,
        typer.Option(
            '--core',
            metavar='N',
            help='Run on this core.',
            show_default='the last that is allowed',
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option('--json', help='Print figures as JSON on stdout.')
    ] = False,
) -> None:
    """Time strapdown beside python-ins, and the filter beside filterpy.

    Results are compared first: when they differ, nothing is timed. Times are processor times on
    one core; on a shared machine only the ratios mean something, each taken within a round.
    """
    from ..benchmarks import machine

    used = machine.pin(processor)  # before anything numerical is loaded
    from ..benchmarks.core import DISTRIBUTIONS, run

    before = machine.describe(DISTRIBUTIONS)
    result = run(samples=samples, rounds=rounds, tell=say)
    facts = {**before, 'core': used, 'load_average_after': machine.load()}
    if as_json:
        emit_json({'machine': facts, **result.to_dict()})
        return
    from rich.console import Console

    from ..terminal import print_table

    console = Console(highlight=False)
    for group in result.groups:
        print_table(console, group.table())
    worst = max(v for k, v in result.agreement_m.items() if 'horizontal' in k)
    covariance = max(result.agreement_covariance.values())
    sys.stdout.write(
        f'Same results: positions within {1e3 * worst:.1f} mm horizontally of python-ins after'
        f' {result.compared_samples} samples, covariances within {covariance:.0e}'
        ' of filterpy.\n'
        f'{facts["cpu"]}, core {used} of {facts["cores"]}, load {facts["load_average"]:.1f} to'
        f' {facts["load_average_after"]:.1f}, Python {facts["python"]}, '
        + ', '.join(f'{k} {v}' for k, v in machine.versions(DISTRIBUTIONS).items())
        + f'; medians of {rounds} rounds.\n'
    )
