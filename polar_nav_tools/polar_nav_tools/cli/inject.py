"""`polar inject`: a bag with faults, to see what a filter does with them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, require, say
from .arguments import existing
from .bags import JsonOption, VehicleOption, opened

if TYPE_CHECKING:
    from ..inject.faults import Fault
    from ..inject.files import FileFault


@app.command(
    epilog='Example: `./polar inject bags/my_run --fault imu_silent:3@100 --out bags/faulty`, '
    'then `./polar score bags/faulty`'
)
def inject(
    bag: Annotated[
        Path | None,
        typer.Argument(metavar='BAG', help='Folder of a bag, or an .mcap file.'),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            '--fault', metavar='NAME[:SIZE]@S', help='Fault at a time since the first IMU message.'
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option('--out', '-o', help='Folder of the new bag.')] = None,
    seed: Annotated[int, typer.Option(min=0, help='Of what faults draw at random.')] = 1,
    listed: Annotated[bool, typer.Option('--list', help='List the faults.')] = False,
    vehicle: VehicleOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a bag with faults of sensors, clocks, packets or of the file itself.

    What a follower published is left out; replay and score run the filter on what would have
    arrived. `--fault` may be repeated.
    """
    from ..inject.faults import FAULTS, parse
    from ..inject.files import FILE_FAULTS, damage, parse_file

    if listed:
        _list([*FAULTS.values()], as_json)
        return
    if bag is None or out is None or not fault:
        raise typer.BadParameter('expected BAG, --fault and --out, or --list')
    bag = existing(bag)
    of_file = [text for text in fault if text.split(':')[0].split('@')[0] in FILE_FAULTS]
    if of_file:
        if len(of_file) < len(fault):
            raise typer.BadParameter('faults of files go alone: inject others first')
        result = damage(bag, [parse_file(t) for t in of_file], out, seed)
        if as_json:
            emit_json({'ok': True, **result.to_dict()})
        else:
            sys.stdout.write(f'{result.target}: {", ".join(result.faults)}\n')
        return
    injections = [parse(text) for text in fault]
    from ..inject.bag import inject_bag

    with opened(bag, whole=True) as source:
        done = inject_bag(source, injections, out, seed, vehicle)
        if as_json:
            emit_json({'ok': not source.problems, **done.to_dict()})
        else:
            sys.stdout.write(
                f'{done.target}: {done.changed} messages changed, {done.left_out} left out, '
                f'{done.added} added\n'
            )
        if not (done.changed or done.left_out or done.added):
            say('nothing was changed')
            require(False)


def _list(faults: list[Fault], as_json: bool) -> None:
    from ..inject.files import FILE_FAULTS

    both: list[Fault | FileFault] = [*faults, *FILE_FAULTS.values()]
    rows = [
        {'name': f.name, 'about': f.doc, 'size': f.size, 'unit': f.unit, 'modes': list(f.modes)}
        for f in both
    ]
    if as_json:
        emit_json({'ok': True, 'faults': rows})
        return
    width = max(len(str(row['name'])) for row in rows)
    for row in rows:
        size = f' ({row["size"]:g} {row["unit"]})' if row['unit'] else ''
        sys.stdout.write(f'{row["name"]:<{width}}  {row["about"]}{size}\n')
