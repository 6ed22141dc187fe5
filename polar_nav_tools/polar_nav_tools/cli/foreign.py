"""`polar map`, `polar import csv` and `polar replay --map`: data recorded by other systems."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from polar_nav_core.errors import ConfigError

from .app import app, emit_json, require, say
from .arguments import MaybeBagArgument, MsgPathOption
from .choices import DVL_CLASSES, IMU_CLASSES, REFERENCES, STAMPS, one_of
from .mapped import open_mapped

if TYPE_CHECKING:
    from ..foreign.guess_noise import Choices

JsonOption = Annotated[bool, typer.Option('--json', help='Print figures as JSON on stdout.')]
import_app = typer.Typer(no_args_is_help=True, help='Make a bag of data that were never a bag.')
app.add_typer(import_app, name='import')


@app.command(
    name='map',
    epilog='Example: `./polar map cruise.bag > mapping.yaml`, or `./polar map --live > ...`',
)
def map_(
    bag: MaybeBagArgument = None,
    imu: Annotated[
        str | None,
        typer.Option(
            '--imu',
            metavar='CLASS',
            help=f'Class of the IMU, its noise: {", ".join(IMU_CLASSES)}.',
        ),
    ] = None,
    dvl: Annotated[
        str | None,
        typer.Option(
            '--dvl',
            metavar='CLASS',
            help=f'Class of the DVL, its noise: {", ".join(DVL_CLASSES)}.',
        ),
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option('--reference', metavar=one_of(REFERENCES), help='Of DVL velocities.'),
    ] = None,
    clock: Annotated[
        str | None,
        typer.Option('--clock', metavar=one_of(STAMPS), help='Where times of validity stand.'),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            '--vehicle', metavar='NAMESPACE', help='Which one, where several have an IMU.'
        ),
    ] = None,
    msg_path: MsgPathOption = None,
    live: Annotated[
        bool, typer.Option('--live', help='Listen to the running graph instead of a bag.')
    ] = False,
    seconds: Annotated[
        float, typer.Option('--seconds', min=1.0, max=3600.0, help='How long --live listens.')
    ] = 10.0,
) -> None:
    """Guess which topic is what, and print a mapping for `polar replay --map` and the nodes.

    Comments in it say what was guessed from what, and what has to be filled in by hand.
    Instruments and clock that no option states are asked for on a terminal. With --live the topics
    are those of the running graph, in the ROS domain of the shell.
    """
    if live == (bag is not None):
        raise typer.BadParameter('give a bag, or --live', param_hint='BAG')
    from polar_nav_ros.adapters.mapping import REFERENCES, STAMPS
    from polar_nav_ros.adapters.noise_classes import DVL_CLASSES, IMU_CLASSES

    from ..foreign.definitions import undecodable
    from ..foreign.guess import guess
    from ..foreign.guess_noise import Choices
    from ..foreign.sources import not_described, open_source
    from ..terminal.progress import opening_display

    chosen = Choices(
        imu=_chosen('--imu', imu, IMU_CLASSES),
        dvl=_chosen('--dvl', dvl, DVL_CLASSES),
        reference=_chosen('--reference', reference, REFERENCES),
        clock=_chosen('--clock', clock, STAMPS),
        vehicle=vehicle,
    )
    if bag is None:
        _map_live(chosen, seconds, msg_path)
        return
    with opening_display(bag) as progress:
        source = open_source(bag, progress, msg_path=msg_path)
    for problem in source.problems:
        say(f'{bag}: {problem}')
    missing = undecodable(not_described(source))
    if missing is not None:
        say(f'{bag}: {missing}')
    sys.stdout.write(guess(source, chosen))


def _map_live(chosen: Choices, seconds: float, msg_path: Path | None) -> None:
    """Print a mapping of the running graph."""
    from ..foreign.guess import guess
    from ..foreign.listen import Listening
    from ..terminal.progress import progress_display

    with Listening() as listening:
        with progress_display('listening', total=seconds, unit='s') as update:
            heard = listening.hear(seconds, update, msg_path)
        for note in heard.notes:
            if 'not heard' in note or 'nothing came' in note:
                say(note)
        sys.stdout.write(guess(heard.source, chosen, heard.notes))


def _chosen(option: str, given: str | None, options: tuple[str, ...]) -> str | None:
    """Check what an option states, or ask for it on a terminal; None where nobody knows."""
    value = given
    if value is None and sys.stdin.isatty() and sys.stderr.isatty():
        text = f'{option} ({", ".join(options)}; empty: not known)'
        value = typer.prompt(text, default='', show_default=False, err=True).strip() or None
    if value is not None and value not in options:
        raise typer.BadParameter(f'{value!r} is none of {", ".join(options)}', param_hint=option)
    return value


@import_app.command(
    name='csv', epilog='Example: `./polar import csv columns.yaml --out bags/cruise`'
)
def csv(
    columns: Annotated[
        Path,
        typer.Argument(
            metavar='COLUMNS.YAML', help='Files, columns and units; see docs/your-bags.md.'
        ),
    ],
    out: Annotated[
        Path, typer.Option('--out', '-o', help='Folder of the new bag.', show_default=False)
    ],
    as_json: JsonOption = False,
) -> None:
    """Write the columns of CSV files to a bag with messages of this project.

    Beside the bag a mapping is written, with which `polar replay --map` takes it.
    """
    from ..foreign.table import import_csv

    if out.exists():
        raise ConfigError(f'{out} exists already; a bag is never overwritten')
    result = import_csv(columns, out)
    if as_json:
        emit_json({'ok': True, **result.to_dict()})
        return
    for topic, count in result.counts.items():
        sys.stdout.write(f'{topic:>28}: {count} messages\n')
    sys.stdout.write(f'{result.bag}\n{result.mapping}\n')


def replay_foreign(
    bag: Path,
    mapping_path: Path,
    configuration: str | None,
    changes: list[str],
    accept: list[str],
    out: Path | None,
    msg_path: Path | None,
    as_json: bool,
) -> None:
    """Run `polar replay --map`: check the bag, replay it, print and write the results."""
    from rich.console import Console

    from ..foreign import replay
    from ..foreign.findings import to_dict as finding_values
    from ..replay.output import parse_changes
    from ..terminal.progress import progress_display
    from ..terminal.tables import print_table

    if out is not None and out.exists():
        raise ConfigError(f'{out} exists already; a bag is never overwritten')
    chosen = dict(parse_changes(changes))
    if configuration is not None:
        chosen['configuration'] = configuration
    source, what = open_mapped(bag, mapping_path, chosen, msg_path)
    with progress_display('replay', total=100.0, unit='%') as update:
        run = replay.replay(
            source,
            what,
            accept=accept,
            messages=out is not None,
            progress=lambda share: update(100.0 * share, 100.0),
        )
    said = replay.summary(run)
    if out is not None:
        said['written'] = str(replay.write(out, run))
    compared = run.comparison()
    if compared is not None:
        said['nees'] = replay.nees_judged(compared)
    if as_json:
        emit_json(
            {
                'ok': not (source.problems or run.complaints()),
                'path': said.pop('bag'),
                **said,
                'findings': [finding_values(f) for f in run.findings],
                'score': None if compared is None else compared.to_dict(),
            }
        )
    else:
        console = Console(highlight=False)
        for name, value in said.items():
            shown = (
                ', '.join(f'{k} {v}' for k, v in value.items())
                if isinstance(value, dict)
                else value
            )
            sys.stdout.write(f'{name:>14}: {shown}\n')
        for finding in run.findings:
            when = '' if finding.stamp_ns is None else f' at {finding.stamp_ns / 1e9:.3f} s'
            say(
                f'{finding.severity.name.lower()}: {finding.name}: {finding.topic}{when}: '
                f'{finding.text}'
            )
        if compared is not None:
            print_table(console, compared.table())
    for complaint in [*run.complaints(), *([run.remark] if run.remark else [])]:
        say(complaint)
    require(not (run.complaints() or source.problems))
