"""Jobs of the experiment `faults`, in the form of all experiments."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from polar_nav_core.engine.events import Event
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid

from ...inject.events import readings_of
from ...inject.faults import inject
from ...inject.readings import Reading
from ...scoring.tables import Table
from ..choices import choices_from
from ..columns import filter_columns
from ..experiment import Experiment
from ..jobs import RowJob, RunResult
from ..mismatch.plan import as_stated
from ..request import Request, Size
from ..station.columns import COLUMNS as STATION_COLUMNS
from ..station.world import StationWorld
from ..station_choices import StationChoices
from ..suite import Paper, engine_suite
from ..world import World
from .drive import Trace, drive
from .judge import Errors, judge
from .rows import Row, rows_named, true_positions
from .table import long_table, tables

COLUMNS = ('default', 'modified_akf', 'conventional_akf')
"""Filters by default; rows of station mode run those that it has."""
_OUTPUT_S = 0.5


class FaultJob(RowJob[Row]):
    """One run to make, beside the run without the fault."""


@dataclass(frozen=True, kw_only=True)
class FaultResult(RunResult):
    """Result of a run: judgement in words, and its numbers as metrics."""

    verdict: str = ''
    sentence: str = ''


@dataclass(frozen=True)
class _Clean:
    """Run of a filter without a fault."""

    params: EngineParams
    trace: Trace
    errors: Errors


@dataclass(frozen=True)
class _Made:
    """World of a seed as readings, and runs in it without faults by filter."""

    world: World | StationWorld
    readings: list[Reading]
    events: list[Event]
    clean: dict[str, _Clean]


_made: dict[tuple[str, int], _Made] = {}


def _world_of(row: Row, seed: int) -> _Made:
    """World of a seed; the newest is kept, for jobs come scene by scene."""
    key = (repr(row.scene), seed)
    if key not in _made:
        _made.clear()
        world: Any = row.scene.make(seed)
        _made[key] = _Made(world, *readings_of(world.inputs), {})
    return _made[key]


def _params(world: World | StationWorld, changes: Mapping[str, Any]) -> EngineParams:
    usual = {'output_period_s': _OUTPUT_S, **changes}
    if isinstance(world, World):
        return world.params(**usual)
    return world.params(StationChoices(), 0.0, **usual)


def _start_ns(world: World | StationWorld) -> int:
    return world.truth.start_ns if isinstance(world, World) else world.run.start_ns


def _drive(
    made: _Made, params: EngineParams, readings: Sequence[Reading], length_s: float
) -> Trace:
    start_ns = _start_ns(made.world)
    return drive(params, readings, made.events, start_ns, start_ns + round(length_s * 1e9))


def _errors(world: World | StationWorld, trace: Trace, length_s: float) -> Errors:
    """Errors of the estimates within the run, in the order of their true times."""
    inside = np.flatnonzero((trace.time_s >= 0.0) & (trace.time_s <= length_s))
    rows = inside[np.argsort(trace.time_s[inside], kind='stable')]
    true_e = true_positions(world, trace.time_s[rows])
    d_r_e = trace.r_e[rows] - true_e
    C_e_G = np.asarray(ecef_to_grid(true_e)) if len(rows) else np.zeros((0, 3, 3))
    return Errors(trace.time_s[rows], np.einsum('nij,nj->ni', C_e_G, d_r_e), trace.sigma_G[rows])


def run_job(job: FaultJob) -> FaultResult:
    """Result of a run of one filter with one fault."""
    row, made = job.row, _world_of(job.row, job.seed)
    length_s = row.scene.duration_s
    start = time.process_time()
    clean = made.clean.get(job.column)
    if clean is None:
        params = _params(made.world, job.changes)
        trace = _drive(made, params, made.readings, length_s)
        clean = _Clean(params, trace, _errors(made.world, trace, length_s))
        made.clean[job.column] = clean
    readings = inject(made.readings, [row.injection], job.seed)
    stopped = ''
    try:
        trace = _drive(made, clean.params, readings, length_s)
    except Exception as error:  # noqa: BLE001 - the node would end: the worst of all results
        stopped = f'{type(error).__name__}: {error}'
        trace = Trace(
            np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), (), np.zeros(0), np.zeros(0), stopped
        )
    judged = judge(
        clean.errors,
        clean.trace.words,
        _errors(made.world, trace, length_s),
        trace,
        row.injection.at_s,
        row.injection.end_s,
        length_s,
    )
    metrics = {k: v for k, v in asdict(judged).items() if isinstance(v, float)}
    stopped_s = float(trace.time_s.max()) if trace.ended and len(trace.time_s) else math.nan
    return FaultResult(
        row.name,
        job.column,
        job.seed,
        metrics,
        stopped_s,
        trace.ended,
        {},
        time.process_time() - start,
        verdict=judged.verdict,
        sentence=stopped or judged.sentence,
    )


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
        FaultJob(row, name, doc, seed, {**as_stated(row.mode), **changes, **engine})
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
                'about': row.injection.fault.doc,
                'mode': row.mode,
                'fault': row.injection.text,
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
