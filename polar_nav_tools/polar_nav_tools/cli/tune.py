"""`polar tune`: noise of the instruments out of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, require, say
from .arguments import AcceptOption, ChangeOption, MapOption, MsgPathOption
from .bags import BagArgument, JsonOption, VehicleOption, percent
from .mapped import open_mapped
from .written import copy_of, write_copy, written_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..foreign.mapping_text import Written
    from ..tuning.bag import Tuning


@app.command(
    epilog='Example: `./polar tune cruise.mcap --map mapping.yaml --write`'
    '\n\nA recording of this project: `./polar tune bags/my_run`'
)
def tune(
    bag: BagArgument,
    write: Annotated[
        bool,
        typer.Option(
            '--write',
            help='Write what is suggested to a copy of the mapping, MAPPING_tuned.yaml; '
            'without --map print it as parameters.',
        ),
    ] = False,
    change: ChangeOption = None,
    vehicle: VehicleOption = None,
    mapping: MapOption = None,
    accept: AcceptOption = None,
    msg_path: MsgPathOption = None,
    as_json: JsonOption = False,
) -> None:
    """Estimate the noise of IMU, DVL, depth and fixes, and judge it by a part held out.

    Suggests numbers and applies none. NOT_EXCITED is what the recording cannot tell, INSEPARABLE
    what it shows only together with another. docs/tune.md says what can be seen.
    """
    if mapping is None and (accept or msg_path is not None):
        raise typer.BadParameter('goes with --map', param_hint='--accept, --msg-path')
    target = copy_of(mapping, 'tuned') if write else None
    if mapping is None:
        found, missing = _own(bag, vehicle, change or [])
    else:
        found, missing = _mapped(bag, mapping, change or [], accept or [], msg_path)
    well = not (missing or found.problems)
    written = _written(found, mapping) if write and not found.problems else None
    if as_json:
        emit_json({**found.to_dict(), **written_values(written, target, 'names'), 'ok': well})
    else:
        _print(found, written=written is not None)
    if written is not None:
        nothing = 'nothing is suggested that a file could state'
        write_copy(written, target, nothing, quiet=as_json)
    for problem in found.problems:
        say(problem)
    if write and written is None:
        say('nothing was written')
    require(well)


def _own(bag: Path, vehicle: str | None, change: list[str]) -> tuple[Tuning, Sequence[object]]:
    from ..analysis.opening import open_for
    from ..replay.output import parse_changes
    from ..replay.recorded import choose_follower
    from ..tuning.bag import tune_bag

    source, changes = open_for(bag, say), parse_changes(change)
    name = choose_follower(source, vehicle)[0]
    with percent('tune') as progress:
        found = tune_bag(source, name, changes=changes, progress=progress)
    return found, source.problems


def _mapped(
    bag: Path, mapping: Path, change: list[str], accept: list[str], msg_path: Path | None
) -> tuple[Tuning, Sequence[object]]:
    from ..replay.output import parse_changes
    from ..tuning.bag import tune_mapped

    changes = {**parse_changes(change), 'configuration': 'default'}
    source, what = open_mapped(bag, mapping, changes, msg_path)
    with percent('tune') as progress:
        found = tune_mapped(source, what, accept=accept, progress=progress)
    return found, source.problems


def _written(found: Tuning, mapping: Path | None) -> Written:
    from polar_nav_ros.adapters import mapping_file as files

    from ..tuning import write

    if mapping is None:
        return write.parameter_lines(found)
    written = write.mapping_file(mapping, found, files.load(mapping))
    files.parse(written.text, f'tuned {mapping}')  # refuses before anything is written
    return written


def _print(found: Tuning, *, written: bool) -> None:
    from rich.console import Console
    from rich.text import Text

    from ..terminal.tables import print_table
    from ..tuning.verdicts import judgement, nees_words, nis_table, notes, sentence, table

    console = Console(highlight=False)
    whole = not console.is_terminal  # a file has no edge
    title = f'{found.run.vehicle}, {found.run.recorded:%Y-%m-%d}: noise as the data show it'
    print_table(console, table(title, found.lines))
    print_table(console, nis_table(found.found.judged))
    out = [f'{line.parameter.label}: {line.why}' for line in found.lines if line.why]
    out += [
        judgement(found.found.judged, suggested=found.found.instead is None),
        *nees_words(found.found.nees),
        *notes(found.found),
    ]
    out.append(sentence(found.found, found.lines))
    if not written:
        out.append('nothing was changed: `--write` writes a copy')
    for text in out:
        console.print(Text(text), soft_wrap=whole)
