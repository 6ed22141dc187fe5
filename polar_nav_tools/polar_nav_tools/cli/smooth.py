"""`polar smooth`: the best track that a recording holds."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from polar_nav_core.errors import ConfigError

from .app import app, emit_json, require, say
from .arguments import AcceptOption, ChangeOption, MapOption, MsgPathOption
from .bags import BagArgument, JsonOption, VehicleOption, percent
from .choices import FRAMES, one_of
from .mapped import open_mapped

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from polar_nav_core.engine.health.span import Span

    from ..smoothing.bag import AnySmoothed, How, SmoothedRun

_CLOSE_S = 0.05
"""From one estimate to the next, between which those at other times lie [s]."""


@app.command(
    epilog='Example: `./polar smooth bags/my_run --out bags/my_run_smoothed`'
    '\n\nFor a map: `./polar smooth cruise.mcap --map mapping.yaml --csv track.csv --at /sonar`'
)
def smooth(
    bag: BagArgument,
    out: Annotated[
        Path | None, typer.Option('--out', '-o', help='Folder of a new bag with nav/state.')
    ] = None,
    tum: Annotated[Path | None, typer.Option('--tum', help='New file: TUM.')] = None,
    csv: Annotated[Path | None, typer.Option('--csv', help='New file: CSV.')] = None,
    kml: Annotated[Path | None, typer.Option('--kml', help='New file: KML.')] = None,
    frame: Annotated[
        str, typer.Option('--frame', metavar=one_of(FRAMES), help='Of --tum and --csv.')
    ] = 'ecef',
    every: Annotated[
        float,
        typer.Option('--every', metavar='S', min=0.01, help='From one estimate to the next.'),
    ] = 1.0,
    at: Annotated[
        str | None,
        typer.Option(
            '--at',
            metavar='TOPIC',
            help='Files have the times of its messages (a camera, a sonar).',
        ),
    ] = None,
    configuration: Annotated[
        str,
        typer.Option('--configuration', '-c', metavar='NAME', help='Whose gate and weights.'),
    ] = 'default',
    change: ChangeOption = None,
    passes: Annotated[
        int,
        typer.Option(
            '--passes',
            metavar='N',
            min=1,
            max=3,
            help='Most passes; with 1 the gates are those of the filter.',
        ),
    ] = 3,
    vehicle: VehicleOption = None,
    mapping: MapOption = None,
    accept: AcceptOption = None,
    msg_path: MsgPathOption = None,
    as_json: JsonOption = False,
) -> None:
    """Estimate a whole track anew, each place by everything measured before and after it.

    How late the fixes came does not matter: each counts when it was valid.
    """
    from polar_nav_core.engine.health.span import span_of_health, words_of_health

    from ..export.formats import trajectory, write_trajectory
    from ..smoothing.bag import How
    from ..smoothing.write import write

    files = {'tum': tum, 'csv': csv, 'kml': kml}
    for path in (out, *files.values()):
        if path is not None and path.exists():
            raise ConfigError(f'{path} exists already; nothing is overwritten')
    if mapping is None and (accept or msg_path is not None):
        raise typer.BadParameter('goes with --map', param_hint='--accept, --msg-path')
    if at is not None and not any(files.values()):
        raise typer.BadParameter('goes with --tum, --csv or --kml', param_hint='--at')
    stamps_ns = None if at is None else _stamps(bag, at, msg_path)
    step_s = every if at is None else min(every, _CLOSE_S)
    how = How(step_s, passes)
    if mapping is None:
        run, missing = _own(bag, vehicle, configuration, change or [], how)
    else:
        words = (accept or [], msg_path, configuration, change or [])
        run, missing = _mapped(bag, mapping, *words, how)
    track = trajectory(run.smoothed)
    if stamps_ns is not None:
        from ..export.at_stamps import at_stamps

        track = at_stamps(track, stamps_ns)
        if track.left_out:
            say(f'{track.left_out} messages of {at} are outside the track and left out')
    for kind, path in files.items():
        if path is not None:
            write_trajectory(path, track, kind=kind, frame=frame if kind != 'kml' else 'ecef')
    if out is not None:
        write(out, run)
    span = span_of_health(run.health)
    of_bag = str(bag) if mapping is None else f'{bag} --map {mapping}'
    well = not (missing or run.found.divergence or span.complaint or run.doubts.complaint)
    _print(run, span, bag=of_bag, well=well, as_json=as_json)
    if run.found.divergence:
        say(f'the filter diverged: {run.found.divergence}')
    if span.any_word:
        say(f'the filter was not well: {span.any_word}')
    said = words_of_health(run.health)
    for sentence in said if len(said) > 1 else ():  # the only one stands above
        say(f'  {sentence}')
    if run.doubts.complaint:
        say(run.doubts.complaint)
    require(well)


def _stamps(bag: Path, topic: str, msg_path: Path | None) -> NDArray[np.int64]:
    """Stamps of a topic's messages; times of the recording where nobody stamped."""
    from ..foreign.guess_stamps import times_of
    from ..foreign.sources import open_source, require
    from ..terminal.progress import opening_display

    with opening_display(bag) as reading:
        source = open_source(bag, reading, msg_path=msg_path)
        require(source, topic, named=True)
        times = times_of(source, topic)
    return times.log_ns if times.stamps_ns is None or not times.stamped else times.stamps_ns


def _own(
    bag: Path,
    vehicle: str | None,
    configuration: str,
    change: list[str],
    how: How,
) -> tuple[SmoothedRun, Sequence[object]]:
    from ..analysis.opening import open_for
    from ..replay.output import parse_changes
    from ..replay.recorded import choose_follower
    from ..smoothing.bag import smooth_bag

    source = open_for(bag, say)
    with percent('smooth') as progress:
        run = smooth_bag(
            source,
            choose_follower(source, vehicle)[0],
            configuration=configuration,
            changes=parse_changes(change),
            how=how,
            progress=progress,
        )
    return run, source.problems


def _mapped(
    bag: Path,
    mapping: Path,
    accept: list[str],
    msg_path: Path | None,
    configuration: str,
    change: list[str],
    how: How,
) -> tuple[SmoothedRun, Sequence[object]]:
    from ..replay.output import parse_changes
    from ..smoothing.bag import smooth_mapped

    changes = {**parse_changes(change), 'configuration': configuration}
    source, what = open_mapped(bag, mapping, changes, msg_path)
    with percent('smooth') as progress:
        run = smooth_mapped(
            source,
            what,
            accept=accept,
            how=how,
            progress=progress,
        )
    return run, source.problems


def _print(run: SmoothedRun, span: Span, *, bag: str, well: bool, as_json: bool) -> None:
    from polar_nav_core.engine.health.span import words_of_health

    from ..smoothing.bag import stated_sigma
    from ..smoothing.write import summary

    comparison = run.comparison
    stated = {'filter': stated_sigma(run.filtered), 'smoother': stated_sigma(run.smoothed)}
    if as_json:
        emit_json(
            {
                'ok': well,
                'path': str(run.path),
                'vehicle': run.vehicle,
                'configuration': run.params.configuration,
                'estimates': len(run.smoothed),
                'stated_horizontal_m': stated,
                'fixes': {
                    name: {'used': used, 'of': total}
                    for name, (used, total) in run.fixes_used.items()
                },
                'filter_health': {
                    **span.to_dict(),
                    'conditions': words_of_health(run.health),
                },
                'doubts': run.doubts.to_dict(bag),
                'smoothing': summary(run.found),
                'score': None if comparison is None else comparison.to_dict(),
            }
        )
        return
    if comparison is not None:
        from rich.console import Console

        from ..terminal.tables import print_table

        print_table(Console(highlight=False), comparison.table())
    sys.stdout.write(
        f'{len(run.smoothed)} smoothed estimates of {run.vehicle}; stated 1-sigma of the '
        f'horizontal position, median: filter {stated["filter"]:.3g} m, '
        f'smoother {stated["smoother"]:.3g} m\n'
        + _fixes(run)
        + _revisions(run.found)
        + ''.join(f'{line}\n' for line in run.doubts.sentences(bag))
    )


def _fixes(run: SmoothedRun) -> str:
    """Line on how many fixes were used: without a truth nothing else shows that few were."""
    words = ', '.join(f'{name} {used} of {of}' for name, (used, of) in run.fixes_used.items())
    return f'fixes used: {words}\n'


_LISTED = 10
"""Revisions that are printed one by one; JSON and the new bag have all."""


def _revisions(found: AnySmoothed) -> str:
    """Sentences on passes, and on what hindsight decided otherwise than the filter."""
    passes = 'one pass' if found.passes == 1 else f'{found.passes} passes'
    moved = '' if found.passes == 1 else f', the last moved the track by {found.moved:.2g} sigma'
    out = [f'{passes}{moved}']
    counts = Counter((r.topic, r.before.name, r.after.name) for r in found.revisions)
    for (topic, before, after), count in sorted(counts.items()):
        out.append(f'with hindsight {before} -> {after}: {count} of {topic}')
    for r in found.revisions[:_LISTED]:
        out.append(
            f'  {r.stamp_ns * 1e-9:.3f} s {r.topic} {r.number}: {r.before.name} -> '
            f'{r.after.name}, NIS {r.nis:.1f}, gate {r.gate:.1f}'
        )
    if len(found.revisions) > _LISTED:
        out.append(f'  and {len(found.revisions) - _LISTED} more')
    if found.unsettled:
        out.append(f'not settled: {found.unsettled}')
    return ''.join(f'{line}\n' for line in out)
