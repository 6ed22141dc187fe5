"""`polar export`: a trajectory of a bag as a file for other people's tools."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from .app import app, emit_json, say
from .bags import BagArgument, JsonOption, VehicleOption, opened
from .choices import FORMATS, FRAMES, one_of


@app.command(
    epilog='Example: `./polar export bags/my_run truth.tum`'
    '\n\nBoth for evo: `./polar export bags/my_run late.tum --what estimate:conventional_akf`, '
    'then `evo_ape tum truth.tum late.tum`'
)
def export(
    bag: BagArgument,
    out: Annotated[Path, typer.Argument(metavar='OUT', help='The new file.', show_default=False)],
    what: Annotated[
        str | None,
        typer.Option(
            '--what',
            metavar='truth|estimate|estimate:NAME|leader',
            help='estimate:CONFIGURATION is replayed; truth by default.',
        ),
    ] = None,
    topic: Annotated[
        str | None,
        typer.Option('--topic', help='A topic instead: truth, nav/state, Odometry in `earth`.'),
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option('--format', metavar=one_of(FORMATS), help='By default by OUT, else tum.'),
    ] = None,
    frame: Annotated[
        str,
        typer.Option(
            '--frame',
            metavar=one_of(FRAMES),
            help='enu and grid at the first true position; epsg: map coordinates and height.',
        ),
    ] = 'ecef',
    vehicle: VehicleOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a trajectory as TUM (`time x y z qx qy qz qw`), CSV or KML, pose of base_link.

    Every number is written so that it reads back as the same float64.
    """
    from ..export.formats import write_trajectory
    from ..export.source import exported, from_topic, origin_of

    if topic is not None and what is not None:
        raise typer.BadParameter('--what and --topic exclude each other')
    if out.exists():
        raise typer.BadParameter(f'{out} exists already')
    chosen = kind or (out.suffix[1:] if out.suffix[1:] in FORMATS else 'tum')
    with opened(bag) as source:
        track = from_topic(source, topic) if topic else exported(source, what or 'truth', vehicle)
        # Without a follower's truth the origin is the trajectory's first pose.
        origin = origin_of(source, vehicle) if frame in ('enu', 'grid') else None
        write_trajectory(out, track, kind=chosen, frame=frame, origin_r_e=origin)
        if track.left_out:
            say(f'{track.left_out} samples have no pose and are left out')
        if as_json:
            emit_json(
                {
                    'ok': not source.problems,
                    'path': str(source.path),
                    'file': str(out),
                    'poses': len(track),
                    'left_out': track.left_out,
                    'format': chosen,
                    'frame': frame,
                }
            )
        else:
            sys.stdout.write(f'{out}: {len(track)} poses, {chosen}, {frame}\n')
