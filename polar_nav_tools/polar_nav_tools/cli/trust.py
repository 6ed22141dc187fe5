"""`polar verify`, `polar doctor`: whether a bag, and what was made of it, can be believed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, require, say
from .arguments import AnyBagArgument, MsgPathOption
from .bags import BagArgument, JsonOption, VehicleOption, opened, percent

if TYPE_CHECKING:
    from ..doctor.examine import Examination
    from ..replay.certificate import Check
    from ..replay.comparison import Comparison
    from ..replay.verification import VerifyResult
    from ..series.closeness import Closeness


@app.command(
    epilog='Example: `./polar verify bags/my_run`'
    '\n\nFor others: `./polar verify bags/my_run --write-certificate my_run.json`, '
    'and there: `./polar verify my_run --certificate my_run.json`'
)
def verify(
    bag: BagArgument,
    certificate: Annotated[
        Path | None,
        typer.Option('--certificate', help='Check this certificate of the bag.'),
    ] = None,
    write_certificate: Annotated[
        Path | None,
        typer.Option('--write-certificate', help='Write a certificate (JSON) if all is equal.'),
    ] = None,
    vehicle: VehicleOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare the recorded estimates with a replay, bit for bit.

    A certificate names the bag, the parameters, the packages, the processor and the hashes of what
    came out. With the same packages on the same model of processor the bits must be equal;
    elsewhere a replay may differ by rounding, up to 1e-6 sigma. A bag that was recorded with
    another engine version is compared to 1e-6 sigma, too.
    """
    from ..replay.by_message import replay
    from ..replay.certificate import certify, check, read_certificate
    from ..replay.verification import load_comparable
    from ..replay.verification import verify as run_verify

    stated = None if certificate is None else read_certificate(certificate)
    if write_certificate is not None and write_certificate.exists():
        raise typer.BadParameter(f'{write_certificate} exists already')
    with opened(bag, whole=True) as source:
        inputs = load_comparable(source, vehicle)
        with percent('replay') as progress:
            replayed = replay(inputs, progress=progress)
        result = run_verify(inputs, replayed=replayed)
        checked = None if stated is None else check(stated, inputs, replayed, result)
        well = result.ok if checked is None else checked.ok
        written = ''
        if write_certificate is not None:
            certify(inputs, replayed, result).write(write_certificate)
            written = str(write_certificate)
        if as_json:
            emit_json(
                {
                    'ok': well and not source.problems,
                    'path': str(source.path),
                    **_plain(result),
                    'certificate': None if checked is None else checked.to_dict(),
                    'certificate_written': written or None,
                }
            )
        else:
            _print(result, checked)
            if written:
                sys.stdout.write(f'certificate: {written}\n')
        if checked is not None:
            for failure in checked.failures:
                say(failure)
        elif result.comparison is not None:
            for problem in result.comparison.problems():
                say(f'recorded with engine {result.engine_version}: {problem}')
        elif not result.equal:
            for problem in result.problems[len(source.problems) :]:  # those of the bag are said
                say(problem)
            say(f'live and replay differ: {result.difference}')
        require(well)


def _plain(result: VerifyResult) -> dict[str, object]:
    topics = {
        topic: {
            'live_sha256': result.live_sha256[topic],
            'replay_sha256': result.replay_sha256[topic],
            'live_messages': result.counts[topic][0],
            'replayed_messages': result.counts[topic][1],
        }
        for topic in result.live_sha256
    }
    from polar_nav_core.engine.version import ENGINE_VERSION

    difference = str(result.difference) if result.difference else None
    comparison = None if result.comparison is None else result.comparison.to_dict()
    return {
        'equal': result.equal,
        'vehicle': result.vehicle,
        'topics': topics,
        'first_difference': difference,
        'engine_version': {'recorded': result.engine_version, 'replayed': ENGINE_VERSION},
        'comparison': comparison,
        'lives_s': result.lives_s,
        'torn': result.torn,
        'retired_parameters': result.retired,
        'problems': result.problems,
        'unheard': result.unheard,
    }


def _print(result: VerifyResult, checked: Check | None) -> None:
    for topic, digest in result.live_sha256.items():
        live, replayed = result.counts[topic]
        sys.stdout.write(f'/{result.vehicle}/{topic}\n')
        sys.stdout.write(f'  live   {live:>7} messages, sha256 {digest}\n')
        sys.stdout.write(
            f'  replay {replayed:>7} messages, sha256 {result.replay_sha256[topic]}\n'
        )
    for sentence in (*result.retired, *result.unheard):
        sys.stdout.write(f'{sentence}\n')
    if result.comparison is not None and checked is None:
        _print_comparison(result.engine_version, result.comparison)
    if result.lives_text:
        sys.stdout.write(f'{result.lives_text}{": equal" if result.equal else ""}\n')
    if result.equal:
        sys.stdout.write('equal, bit for bit\n')
    if result.torn:
        sys.stdout.write('what was published after a hole in the recording is not compared\n')
    if checked is None:
        return
    for note in checked.notes:
        sys.stdout.write(f'  {note}\n')
    if checked.closeness is not None:
        _print_closeness(checked.closeness)
    sys.stdout.write(f'the certificate {"holds" if checked.ok else "does not hold"}\n')


def _print_comparison(engine_version: int, comparison: Comparison) -> None:
    from ..series.closeness import LIMIT_TEXT

    how = 'not comparable' if comparison.closeness is None else f'compared to {LIMIT_TEXT}'
    sys.stdout.write(f'recorded with engine {engine_version}: {how}\n')
    if comparison.closeness is not None:
        _print_closeness(comparison.closeness)


def _print_closeness(c: Closeness) -> None:
    where = f', {c.what} at {c.stamp_ns * 1e-9:.3f} s' if c.sigmas > 0.0 else ''
    sys.stdout.write(f'largest difference: {c.sigmas:.3g} sigma{where}\n')


@app.command(
    epilog='Example: `./polar doctor bags/my_run`'
    '\n\nAs a gate in a script: `./polar doctor bags/my_run --json > health.json || exit 1`'
)
def doctor(
    bag: AnyBagArgument,
    everything: Annotated[bool, typer.Option('--all', help='Show what is well, too.')] = False,
    msg_path: MsgPathOption = None,
    as_json: JsonOption = False,
) -> None:
    """Examine a bag: what is missing, gaps, rates, stamps, and whether every message adds up.

    Needs nothing of this project in the bag, which is MCAP, sqlite3 or ROS 1. The exit status is 1
    when there is an error; warnings do not change it.
    """
    from ..doctor.examine import examine
    from ..foreign.sources import open_source
    from ..terminal.progress import opening_display

    with opening_display(bag) as opening:
        source = open_source(bag, opening, msg_path=msg_path, whole=True)
    with percent('examine') as progress:
        examination = examine(source, progress=progress)
    if as_json:
        emit_json(examination.to_dict())
    else:
        _print_examination(examination, everything)
    require(examination.ok)


def _print_examination(examination: Examination, everything: bool) -> None:
    from rich.console import Console

    from ..bags.finding import Severity
    from ..doctor.wording import line
    from ..terminal.tables import print_table

    console = Console(highlight=False)
    if everything:
        print_table(console, examination.table())
    for finding in examination.findings:
        if finding.severity is not Severity.OK or everything:
            console.print(line(finding), soft_wrap=True, markup=False)
    console.print(examination.summary(), soft_wrap=True, markup=False)
