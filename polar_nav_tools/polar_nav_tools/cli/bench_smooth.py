"""`polar bench smooth`: passes of the smoother beside the filter, simulated or of recordings."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import emit_json, require, say
from .arguments import AcceptOption, MapOption, MsgPathOption, existing
from .bags import VehicleOption
from .bench import bench
from .bench_facts import CoreOption, JsonOption, facts_of, machine_line, one_core, print_tables
from .mapped import open_mapped

if TYPE_CHECKING:
    from polar_nav_core.engine.inputs import Inputs
    from polar_nav_core.engine.params import EngineParams


def _existing(bags: list[Path] | None) -> list[Path] | None:
    return None if bags is None else [existing(bag) for bag in bags]


@bench.command(
    epilog='Example: `./polar bench smooth`\n\n'
    'Quick look: `./polar bench smooth --seconds 60 --rounds 1`\n\n'
    'Recordings: `./polar bench smooth bags/dive_1 bags/dive_2`'
)
def smooth(
    bags: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar='[BAG...]',
            help='Recordings to smooth; without one a run is simulated.',
            show_default=False,
            callback=_existing,
        ),
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help='Rounds; ratios are their medians.')] = 5,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=30.0, max=3600.0, help='Length of the simulated run.', show_default='600'
        ),
    ] = None,
    vehicle: VehicleOption = None,
    mapping: MapOption = None,
    accept: AcceptOption = None,
    msg_path: MsgPathOption = None,
    processor: CoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Time the passes of the smoother beside the filter, and beside GTSAM where it is installed.

    GTSAM solves the same linear problem, and has to find the same means and sigmas first. Times
    are processor times on one core; reading a recording is not in them.
    """
    if bags and seconds is not None:
        raise typer.BadParameter('a bag is timed as long as it is', param_hint='--seconds')
    if not bags and vehicle is not None:
        raise typer.BadParameter('goes with a bag', param_hint='--vehicle')
    if mapping is not None and not bags:
        raise typer.BadParameter('goes with a bag', param_hint='--map')
    if mapping is None and (accept or msg_path is not None):
        raise typer.BadParameter('goes with --map', param_hint='--accept, --msg-path')
    used = one_core(processor)  # before anything numerical is loaded
    from ..benchmarks.smooth import DISTRIBUTIONS, DURATION_S, run, run_recorded

    problems: list[object] = []
    with facts_of(DISTRIBUTIONS, used) as facts:
        if not bags:
            results = [run(rounds=rounds, duration_s=seconds or DURATION_S, report=say)]
        else:
            opened = _recordings(bags, vehicle, mapping, accept or [], msg_path, problems)
            results = [run_recorded(*one, rounds=rounds, report=say) for one in opened]
    figures = {'bags': [r.to_dict() for r in results]} if bags else results[0].to_dict()
    if as_json:
        emit_json({'ok': not problems, 'machine': facts, **figures})
    else:
        for result in results:
            print_tables(result.tables())
        if results[0].peer is not None:
            sys.stdout.write(f'Same results: GTSAM within {results[0].agreement:.1g} sigma.\n')
        sys.stdout.write(machine_line(facts, rounds))
    require(not problems)


def _recordings(
    bags: Sequence[Path],
    vehicle: str | None,
    mapping: Path | None,
    accept: Sequence[str],
    msg_path: Path | None,
    problems: list[object],
) -> Iterator[tuple[str, EngineParams, Inputs]]:
    """Recordings one by one; what is missing in them is said, and appended to ``problems``."""
    from ..analysis.opening import open_for
    from ..replay.recorded import choose_follower
    from ..smoothing.bag import mapped_inputs, recorded_inputs

    for path in bags:
        if mapping is None:
            bag = open_for(path, say)
            problems += bag.problems
            yield str(path), *recorded_inputs(bag, choose_follower(bag, vehicle)[0])
        else:
            source, what = open_mapped(path, mapping, {'configuration': 'default'}, msg_path)
            problems += source.problems
            yield str(path), *mapped_inputs(source, what, accept)
