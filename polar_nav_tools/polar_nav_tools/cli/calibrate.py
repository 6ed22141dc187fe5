"""`polar calibrate`: mountings, lever arms, delays and scales out of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from polar_nav_core.errors import ConfigError

from .app import app, emit_json, require, say
from .arguments import AcceptOption, ChangeOption, MapOption, MsgPathOption
from .bags import BagArgument, JsonOption, VehicleOption, percent
from .mapped import open_mapped
from .written import copy_of, write_copy, written_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..calibration.bag import Calibration, Wanted
    from ..foreign.mapping_text import Written


@app.command(
    epilog='Example: `./polar calibrate cruise.mcap --map mapping.yaml --write`'
    '\n\nHow late are my fixes? `./polar calibrate bags/my_run --only delay`'
)
def calibrate(
    bag: BagArgument,
    only: Annotated[
        list[str] | None,
        typer.Option('--only', metavar='NAME', help='These constants; may be repeated.'),
    ] = None,
    also: Annotated[
        list[str] | None,
        typer.Option('--also', metavar='NAME', help='Besides the usual ones; may be repeated.'),
    ] = None,
    write: Annotated[
        bool,
        typer.Option(
            '--write',
            help='Write what was estimated to a copy of the mapping, MAPPING_calibrated.yaml; '
            'without --map print it as parameters.',
        ),
    ] = False,
    assign: Annotated[
        list[str] | None,
        typer.Option(
            '--assign', metavar='NAME', help='With --write: all of a sum belongs to this constant.'
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option('--plot', help='New .png or .svg: innovations as stated and calibrated.'),
    ] = None,
    change: ChangeOption = None,
    vehicle: VehicleOption = None,
    mapping: MapOption = None,
    accept: AcceptOption = None,
    msg_path: MsgPathOption = None,
    as_json: JsonOption = False,
) -> None:
    """Estimate misalignment, lever arm, delay and scale of sensors from a whole recording.

    With sigma, correlations, and a verdict: NOT_EXCITED with the manoeuvre that would show it, or
    INSEPARABLE for what appears only as a sum. docs/calibrate.md says what can be seen.
    """
    from ..calibration.bag import Wanted

    if mapping is None and (accept or msg_path is not None):
        raise typer.BadParameter('goes with --map', param_hint='--accept, --msg-path')
    if assign and not write:
        raise typer.BadParameter('goes with --write', param_hint='--assign')
    target = copy_of(mapping, 'calibrated') if write else None
    if plot is not None and plot.exists():
        raise ConfigError(f'{plot} exists already; nothing is overwritten')
    if plot is not None and plot.suffix not in ('.png', '.svg'):
        raise typer.BadParameter('ends with .png or .svg', param_hint='--plot')
    wanted = Wanted(tuple(only or ()), tuple(also or ()))
    if mapping is None:
        found, missing = _own(bag, vehicle, wanted, change or [])
    else:
        words = (change or [], accept or [], msg_path)
        found, missing = _mapped(bag, mapping, wanted, *words)
    well = not (missing or found.problems)
    written = _written(found, mapping, assign or []) if write and not found.problems else None
    if plot is not None:
        from ..calibration.plot import innovations_figure

        innovations_figure(plot, found.found)
    if as_json:
        emit_json({**found.to_dict(), **written_values(written, target, 'constants'), 'ok': well})
    else:
        _print(found)
    if written is not None:
        nothing = 'no constant is estimated that a file could state'
        write_copy(written, target, nothing, quiet=as_json)
    for problem in found.problems:
        say(f'{problem}; nothing is written' if write else problem)
    require(well)


def _own(
    bag: Path, vehicle: str | None, wanted: Wanted, change: list[str]
) -> tuple[Calibration, Sequence[object]]:
    from ..analysis.opening import open_for
    from ..calibration.bag import calibrate_bag
    from ..replay.output import parse_changes
    from ..replay.recorded import choose_follower

    source, changes = open_for(bag, say), parse_changes(change)
    name = choose_follower(source, vehicle)[0]
    with percent('calibrate') as progress:
        found = calibrate_bag(source, name, wanted, changes=changes, progress=progress)
    return found, source.problems


def _mapped(
    bag: Path,
    mapping: Path,
    wanted: Wanted,
    change: list[str],
    accept: list[str],
    msg_path: Path | None,
) -> tuple[Calibration, Sequence[object]]:
    from ..calibration.bag import calibrate_mapped
    from ..replay.output import parse_changes

    changes = {**parse_changes(change), 'configuration': 'default'}
    source, what = open_mapped(bag, mapping, changes, msg_path)
    with percent('calibrate') as progress:
        found = calibrate_mapped(source, what, wanted, accept=accept, progress=progress)
    return found, source.problems


def _written(found: Calibration, mapping: Path | None, assign: list[str]) -> Written:
    from polar_nav_ros.adapters import mapping_file as files

    from ..calibration import write

    if mapping is None:
        return write.parameter_lines(found, assign)
    written = write.mapping_file(mapping, found, files.load(mapping), assign)
    files.parse(written.text, f'calibrated {mapping}')  # refuses before anything is written
    return written


def _print(found: Calibration) -> None:
    from rich.console import Console
    from rich.text import Text

    from ..calibration.verdicts import Verdict, correlations, notes, table
    from ..terminal.tables import print_table

    console = Console(highlight=False)
    whole = not console.is_terminal  # a file has no edge
    title = f'{found.vehicle}, {found.recorded:%Y-%m-%d}: what has to be added to what is stated'
    print_table(console, table(title, found.lines))
    out = []
    if len(found.lines) == 1 and found.lines[0].verdict is Verdict.ESTIMATED:
        line = found.lines[0]
        out.append(f'{line.constant.doc}: {line.value:+.3g} {line.constant.unit}')
    out += [f'{line.constant.name}: {line.why}' for line in found.lines if line.why]
    pairs = correlations(found.found)
    if pairs:
        named = ', '.join(f'{a} and {b} {rho:+.2f}' for a, b, rho in pairs)
        out.append(f'correlated: {named}')
    misfits = found.found.misfits().items()
    fits = ', '.join(f'{name} {before:.3g} -> {after:.3g}' for name, (before, after) in misfits)
    out.append(f'mean squared innovation, as stated -> calibrated: {fits}')
    for text in [*out, *notes(found.found)]:
        console.print(Text(text), soft_wrap=whole)
