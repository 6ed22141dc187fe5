"""Jobs of the experiment `faults`, in the form of all experiments."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from polar_nav_core.errors import ConfigError
from polar_nav_core.params import to_mapping
from polar_nav_follower.params import FollowerParams

from ...scoring.tables import Table
from ..choices import choices_from
from ..columns import filter_columns
from ..experiment import Experiment
from ..jobs import RowJob, RunResult
from ..mismatch.plan import as_stated
from ..received import received
from ..request import Request, Size
from ..station.columns import COLUMNS as STATION_COLUMNS
from ..station.world import StationWorld
from ..suite import Paper, engine_suite
from ..world import World
from .drive import Taken, drive
from .judge import Errors, Judged, judge
from .messages import errors_of, params_of, start_ns_of, taken, with_faults
from .offline import equals, replayed, trace_of
from .row import Row
from .rows import rows_named
from .table import long_table, tables
from .trace import Trace

COLUMNS = ('default', 'modified_akf', 'conventional_akf')
"""Filters by default; rows of station mode run those that it has."""


@dataclass(frozen=True)
class FaultJob(RowJob[Row]):
    """One run to make, beside the run without the fault.

    Attributes
    ----------
    offline : bool
        Whether its recording is replayed, too. What a replay knows is no matter of chance: at the
        first seed only, as it takes longer than the run.
    """

    offline: bool = False


@dataclass(frozen=True, kw_only=True)
class FaultResult(RunResult):
    """Result of a run: judgement in words, and its numbers as metrics.

    Attributes
    ----------
    verdict, sentence : str
        Of the live run.
    offline, offline_sentence : str
        Of its recording, replayed; empty where it was not. Its numbers are metrics named
        ``offline_...``.
    equal : bool
        Whether the replay's estimates and receipts are those of the live run, bit for bit.
    """

    verdict: str = ''
    sentence: str = ''
    offline: str = ''
    offline_sentence: str = ''
    equal: bool = False


@dataclass(frozen=True)
class _Published:
    """What a follower published in a run, and its errors."""

    trace: Trace
    errors: Errors


@dataclass(frozen=True)
class _Ran:
    """A run as published live and, if it was replayed, in a replay, which may be equal."""

    live: _Published
    offline: _Published | None = None
    equal: bool = False


@dataclass(frozen=True)
class _Made:
    """World of a seed as messages, and runs in it without faults by filter."""

    world: World | StationWorld
    messages: list[Taken]
    clean: dict[str, _Ran]


_made: dict[tuple[str, int], _Made] = {}


def _world_of(row: Row, seed: int) -> _Made:
    """World of a seed; the newest is kept, for jobs come scene by scene."""
    key = (repr(row.scene), seed)
    if key not in _made:
        _made.clear()
        world: Any = row.scene.make(seed)
        _made[key] = _Made(world, taken(received(world.inputs)), {})
    return _made[key]


def _run(made: _Made, job: FaultJob, messages: Sequence[Taken]) -> _Ran:
    """Run of a job's filter over messages."""
    length_s = job.row.scene.duration_s
    start_ns = start_ns_of(made.world)
    until_ns = start_ns + round(length_s * 1e9)
    params = FollowerParams(**to_mapping(params_of(made.world, job.changes)))

    def published(trace: Trace) -> _Published:
        return _Published(trace, errors_of(made.world, trace, length_s))

    live = drive(params, messages, start_ns, until_ns)
    one = published(live.trace(until_ns))
    if not job.offline:
        return _Ran(one)
    result = replayed(params, live.record, start_ns)
    other = published(trace_of(result, live, start_ns, until_ns))
    return _Ran(one, other, equals(result, live.record))


def _judged(job: FaultJob, clean: _Published, found: _Published) -> Judged:
    return judge(
        clean.errors,
        clean.trace,
        found.errors,
        found.trace,
        job.row.at_s,
        job.row.end_s,
        job.row.scene.duration_s,
    )


def run_job(job: FaultJob) -> FaultResult:
    """Result of a run of one filter with one fault, live and perhaps replayed."""
    made = _world_of(job.row, job.seed)
    start = time.process_time()
    key = f'{job.column} {job.offline}'
    if key not in made.clean:
        made.clean[key] = _run(made, job, made.messages)
    clean = made.clean[key]
    messages = with_faults(made.messages, job.row.injections, job.seed)
    stopped = ''
    try:
        ran = _run(made, job, messages)
    except Exception as error:  # noqa: BLE001 - the node would end: the worst of all results
        stopped = f'{type(error).__name__}: {error}'
        nothing = Trace.nothing(stopped)
        none = _Published(nothing, errors_of(made.world, nothing, job.row.scene.duration_s))
        ran = _Ran(none, none if job.offline else None)
    live = _judged(job, clean.live, ran.live)
    metrics, offline = _numbers(live), None
    if clean.offline is not None and ran.offline is not None:
        offline = _judged(job, clean.offline, ran.offline)
        metrics |= {f'offline_{name}': value for name, value in _numbers(offline).items()}
    trace = ran.live.trace
    return FaultResult(
        job.row.name,
        job.column,
        job.seed,
        metrics,
        float(trace.time_s.max()) if trace.ended and len(trace.time_s) else math.nan,
        trace.ended,
        {},
        time.process_time() - start,
        verdict=live.verdict,
        sentence=stopped or live.sentence,
        offline='' if offline is None else offline.verdict,
        offline_sentence='' if offline is None else stopped or offline.sentence,
        equal=ran.equal,
    )


def _numbers(judged: Judged) -> dict[str, float]:
    return {k: v for k, v in asdict(judged).items() if isinstance(v, float)}


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[FaultJob]:
    """Jobs of all rows, columns and seeds.

    Raises
    ------
    ConfigError
        For a duration: rows have their own.
    """
    if request.duration_s is not None:
        raise ConfigError('--duration: the rows of faults have their own')
    first = request.first_seed
    engine = dict(request.choices.engine)
    jobs = [
        FaultJob(row, name, doc, seed, {**as_stated(row.mode), **changes, **engine}, seed == first)
        for row in rows_named(request.rows)
        for seed in range(first, first + size.seeds)
        for name, (doc, changes) in _known(row.mode).items()
        if name in columns
    ]
    return sorted(jobs, key=lambda job: (repr(job.row.scene), job.seed))


def _known(mode: str) -> dict[str, tuple[str, dict[str, Any]]]:
    """Text and engine parameters of the filters of a mode, by name."""
    if mode == 'station':
        return {n: (c.doc, c.changes) for n, c in STATION_COLUMNS.items() if not c.uncompensated}
    found = filter_columns(choices_from([]))
    return {n: (c.doc, c.changes) for n, c in found.items() if not c.clairvoyant}


def _read(settings: Sequence[str], columns: Sequence[str] | None) -> dict[str, Any]:
    for setting in settings:
        if not setting.strip().startswith('engine.'):
            raise ConfigError(f'--set {setting}: faults takes engine.PARAMETER only')
    known = {**_known('sins'), **_known('station')}
    for name in columns or ():
        if name not in known:
            raise ConfigError(f'--columns: no filter {name!r}; there are {", ".join(known)}')
    return {'choices': choices_from(settings)}


def _describe(jobs: Sequence[FaultJob]) -> dict[str, Any]:
    rows = {job.row.name: job.row for job in jobs}
    return {
        'filters': {
            f'{job.row.mode}/{job.column}': {'about': job.doc, 'engine': dict(job.changes)}
            for job in jobs
        },
        'groups': {
            name: {
                'about': row.about,
                'mode': row.mode,
                'fault': row.text,
                'duration_s': row.scene.duration_s,
            }
            for name, row in rows.items()
        },
    }


def _long_table(title: str, results: Sequence[RunResult], paper: Paper | None) -> Table:
    del paper
    return long_table(title, [r for r in results if isinstance(r, FaultResult)])


def _tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    del size, request
    return tables([r for r in results if isinstance(r, FaultResult)])


FAULTS = Experiment(
    'faults',
    'Injected faults of messages: recovered, reported, silent or dead? --rows PATTERN',
    Size(280.0, 5),
    Size(280.0, 1),
    COLUMNS,
    plan,
    _tables,
    suite=engine_suite(_read, run_job, _long_table, _describe),
    selects=True,
)
