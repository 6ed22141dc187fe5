"""`polar identify`: drag and current from a recorded bag."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, require, say
from .bags import BagArgument, JsonOption, VehicleOption, opened, percent

if TYPE_CHECKING:
    from ..identify.from_bag import Identified

_LONG = 200_000
"""Messages from which it shows how far it is."""


class Method(StrEnum):
    """Methods of identification."""

    robust = 'robust'
    published = 'published'
    both = 'both'


@app.command(
    epilog='Example: `./polar identify bags/my_run`'
    '\n\nAs it was after 15 minutes, beside the published method: '
    '`./polar identify bags/my_run --until 900 --method both`'
)
def identify(
    bag: BagArgument,
    method: Annotated[
        Method, typer.Option('--method', '-m', help='How; `both` prints one after the other.')
    ] = Method.robust,
    window: Annotated[
        int | None,
        typer.Option(
            '--window', '-w', min=10, help='Newest fixes to take instead of `identify_fixes`.'
        ),
    ] = None,
    until: Annotated[
        float | None,
        typer.Option(
            '--until', min=0.0, help='Only what was known so many seconds after the start.'
        ),
    ] = None,
    change: Annotated[
        list[str] | None,
        typer.Option('--set', metavar='NAME=VALUE', help='Change a follower parameter.'),
    ] = None,
    check: Annotated[
        bool, typer.Option('--check', help='End with status 1 when a result is not accepted.')
    ] = False,
    vehicle: VehicleOption = None,
    as_json: JsonOption = False,
) -> None:
    """Identify a vehicle's drag and the current from attitude, thrust and a station's fixes.

    With sigmas, a verdict, and the manoeuvre that would help where drag and current cannot be told
    apart; beside the truth where the bag has one. docs/identification.md explains the methods.
    """
    from ..identify.from_bag import RecordedRun
    from ..replay.output import parse_changes

    changes = parse_changes(change or [])
    with opened(bag) as source:
        long = source.message_count >= _LONG
        with percent('identify') if long else nullcontext(None) as progress:
            run = RecordedRun(source, vehicle, changes, progress)
        material = run.material(fixes=window, until_s=until)
        names = ('robust', 'published') if method is Method.both else (method.value,)
        results = [run.identified(material, name) for name in names]
        accepted = all(r.result.verdict == 0 for r in results)
        if as_json:
            emit_json(
                {
                    'ok': not source.problems,
                    'path': str(source.path),
                    'accepted': accepted,
                    'identifications': [r.to_dict() for r in results],
                }
            )
        else:
            for i, result in enumerate(results):
                sys.stdout.write('\n' if i else '')
                _print(result)
        require(accepted or not check)


def _print(identified: Identified) -> None:
    from rich.console import Console
    from rich.text import Text

    from ..terminal.tables import print_table

    console = Console(highlight=False)
    whole = not console.is_terminal  # a file has no edge
    r = identified.result
    console.print(Text(f'{r.verdict.name}: {r.reason}', style='bold'), soft_wrap=whole)
    used = f'{r.fixes} of {identified.readable} fixes in {identified.packets} packets'
    if r.iterations:
        print_table(console, identified.table())
        used += (
            f', condition number {r.condition_number:.3g}, cost {r.cost:.4g}, '
            f'{r.iterations} iterations'
        )
    console.print(Text(used), soft_wrap=whole)
    for note in identified.notes:
        say(note)
