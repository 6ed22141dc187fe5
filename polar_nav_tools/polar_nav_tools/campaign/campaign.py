"""A campaign: its plan, its rows, its report."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import ConfigError

from ..experiments.jobs import RunResult
from ..experiments.runner import result_of
from ..live import run_info
from ..scoring.json_values import record
from ..scoring.tables import Table
from ..tasks.attempt import Task, attempt
from ..tasks.execution import Update, Workers, execute, missing
from ..tasks.keys import key_of
from ..tasks.rows import FAILED, Row
from ..tasks.store import Store, begin, opened
from . import report
from .runs import CampaignJob, run_job
from .spec import Spec

_SOURCES = Path(__file__).resolve().parents[3]
_WHAT = f'{run_job.__module__}.{run_job.__qualname__}'


@dataclass(frozen=True)
class Order:
    """What somebody wants of a campaign.

    Attributes
    ----------
    spec : Spec
    runs, first_seed : int
        Seeds of every combination.
    out : Path
    workers : Workers
    resume, failed : bool
        Go on with the rows that are there; do those again that failed, here, one by one.
    """

    spec: Spec
    runs: int
    first_seed: int
    out: Path
    workers: Workers = field(default_factory=Workers)
    resume: bool = False
    failed: bool = False


@dataclass(frozen=True)
class Outcome:
    """Result of a campaign.

    Attributes
    ----------
    tables : list of Table
    manifest : dict
    files : list of Path
    """

    tables: list[Table]
    manifest: dict[str, Any]
    files: list[Path]

    @property
    def failures(self) -> int:
        """Number of runs that failed."""
        return int(self.manifest['runs']['failed'])


def default_folder(file: Path) -> Path:
    """Where the files of a campaign go if nobody says where."""
    return Path('reports') / file.stem


def tasks_of(spec: Spec, runs: int, first_seed: int) -> list[Task]:
    """Tasks of a campaign; those in one world follow one another.

    Raises
    ------
    ConfigError
        For a drawn value that no run can have, naming the file and the key.
    """
    if runs < 1:
        raise ConfigError(f'--runs: {runs} is less than 1')
    combinations = list(spec.combinations())
    found = []
    for seed in range(first_seed, first_seed + runs):
        drawn = spec.drawn(seed)
        tasks = [_task(spec, seed, chosen, drawn) for chosen in combinations]
        scenes = list(dict.fromkeys(task.stretch for task in tasks))
        found += sorted(tasks, key=lambda task: scenes.index(task.stretch))
    return found


def _task(spec: Spec, seed: int, chosen: dict[str, Any], drawn: dict[str, Any]) -> Task:
    """Task of a combination at a seed; those in the same world are of one stretch."""
    point = spec.point({**drawn, **chosen})
    job = CampaignJob(point, seed, _text(chosen))
    names = {n: _plain(v) for n, v in {**chosen, **drawn}.items()}
    world = key_of('world', (point.scene, point.document, seed))
    return Task(key_of(_WHAT, job), names, job, world)


def _text(chosen: dict[str, Any]) -> str:
    return ' '.join(f'{name}={_plain(value)}' for name, value in chosen.items()) or 'all'


def _plain(value: Any) -> str | int | float:  # noqa: ANN401 - a value of a YAML file
    return value if isinstance(value, str | int | float) else json.dumps(value)


def run(order: Order, update: Update, say_waiting: Any) -> Outcome:  # noqa: ANN401 - a callable
    """Outcome of a campaign, run and written to files.

    Raises
    ------
    ConfigError
        If rows of an interrupted campaign would be lost, or nothing failed of which ``failed``
        asks.
    """
    tasks = tasks_of(order.spec, order.runs, order.first_seed)
    with opened(order.out) as store:
        begin(store, resume=order.resume or order.failed)
        kept = sum(task.key in store.rows for task in tasks)
        if order.failed:
            _again(tasks, store, update)
            rows = [store.rows[t.key] for t in tasks if t.key in store.rows]
        else:
            rows = execute(
                tasks, run_job, store, order.workers, update, failures=True, waiting=say_waiting
            )
        files = [store.finish([task.key for task in tasks])]
    return _written(order, tasks, rows, kept, files)


def _again(tasks: Sequence[Task], store: Store, update: Update) -> None:
    """Do the tasks again that failed, here, one by one."""
    to_do = missing(tasks, store, failed=True)
    if not to_do:
        raise ConfigError(f'--failed: no run of {store.folder} failed')
    bad = 0
    for done, task in enumerate(to_do, start=1):
        found = attempt(run_job, task)
        store.add([found.row])
        bad += found.error is not None
        update(done, len(to_do), bad)


def only(spec: Spec, runs: int, first_seed: int, start: str) -> tuple[Row, RunResult | None]:
    """Row and result of the one run whose key starts so, made here; no result if it failed.

    Raises
    ------
    ConfigError
        If none does, or several do.
    """
    found = [t for t in tasks_of(spec, runs, first_seed) if t.key.startswith(start)]
    if len(found) != 1:
        raise ConfigError(f'--only {start}: {len(found) or "no"} runs have such a key')
    row = attempt(run_job, found[0]).row
    return row, None if row.status == FAILED else result_of(row, run_job)


def _written(
    order: Order, tasks: Sequence[Task], rows: Sequence[Row], kept: int, files: list[Path]
) -> Outcome:
    by_key = {task.key: task for task in tasks}
    runs = [
        report.Run(
            row,
            by_key[row.key].argument.group,
            by_key[row.key].argument.seed,
            None if row.status == FAILED else result_of(row, run_job),
        )
        for row in rows
    ]
    again = shlex.join(
        [
            './polar', 'campaign', str(order.spec.file), '--runs', str(order.runs),
            *([] if order.first_seed == 1 else ['--first-seed', str(order.first_seed)]),
            *([] if order.out == default_folder(order.spec.file) else ['--out', str(order.out)]),
        ]
    )  # fmt: skip
    tables = report.tables(runs, again)
    markdown = order.out / 'campaign.md'
    markdown.write_text('\n'.join(t.to_markdown() for t in tables), encoding='utf-8')
    files = [markdown, *files, *report.figures(runs, order.out)]
    manifest = record(
        {
            'spec': str(order.spec.file),
            'shared': dict(order.spec.shared),
            'vary': dict(order.spec.vary),
            'draw': dict(order.spec.draw),
            'seeds': [order.first_seed, order.first_seed + order.runs - 1],
            'command': again,
            'runs': {
                'all': len(tasks),
                'kept': kept,
                'failed': sum(r.result is None for r in runs),
                'stopped': sum(r.result is not None and r.result.stopped for r in runs),
            },
            'processor_s': sum(r.result.seconds for r in runs if r.result is not None),
            'engine_version': ENGINE_VERSION,
            'versions': run_info.versions(),
            'git_commit': run_info.git_commit(_SOURCES),
            'files': [f.name for f in files],
        }
    )
    path = order.out / 'manifest.json'
    path.write_text(json.dumps(manifest, indent=1, allow_nan=False) + '\n', encoding='utf-8')
    return Outcome(tables, manifest, [*files, path])
