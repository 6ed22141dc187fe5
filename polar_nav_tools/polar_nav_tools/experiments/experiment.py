"""One experiment, and its output: tables, figures, one manifest."""

from __future__ import annotations

import json
import platform
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from polar_nav_core.errors import ConfigError

from ..live import run_info
from ..scoring.json_values import record
from ..scoring.tables import Table
from ..tasks.execution import Workers
from ..tasks.store import Store, begin, opened
from .jobs import RunResult
from .request import Request, Size
from .runner import Update, run_jobs, tasks_of
from .suite import POLAR, Suite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SOURCES = Path(__file__).resolve().parents[3]


def no_figures(results: Sequence[RunResult], size: Size, request: Request) -> dict[str, Figure]:
    """No figures: of an experiment that is tables only."""
    del results, size, request
    return {}


@dataclass(frozen=True)
class Experiment:
    """One experiment: its sizes, filters, jobs, tables and figures.

    Attributes
    ----------
    name, doc : str
    full, quick : Size
        Size without and with ``--quick``.
    columns : tuple of str
        Filters by default.
    plan : callable
        Jobs for a request, a size and filters.
    tables : callable
        Tables for results and a size.
    figures : callable
        Figures by name.
    paper : callable or None
        The paper's numbers for a group and a filter, for the CSV.
    suite : Suite
        The suite it belongs to.
    selects : bool
        Whether ``--rows`` and ``--first-seed`` apply.
    """

    name: str
    doc: str
    full: Size
    quick: Size
    columns: tuple[str, ...]
    plan: Callable[[Request, Size, Sequence[str]], Sequence[Any]]
    tables: Callable[[Sequence[RunResult], Size, Request], list[Table]]
    figures: Callable[[Sequence[RunResult], Size, Request], dict[str, Figure]] = no_figures
    paper: Callable[[str, str], Mapping[str, float]] | None = None
    suite: Suite = POLAR
    selects: bool = False

    def size(self, request: Request) -> Size:
        """Size for a request.

        Raises
        ------
        ConfigError
            For a number of seeds or a duration without a run.
        """
        base = self.quick if request.quick else self.full
        duration_s = base.duration_s if request.duration_s is None else request.duration_s
        seeds = base.seeds if request.seeds is None else request.seeds
        if not 10.0 <= duration_s <= 7 * 86400.0:
            raise ConfigError(f'--duration: {duration_s:g} s is outside of [10, 604800] s')
        if seeds < 1:
            raise ConfigError(f'--seeds: {seeds} is less than 1')
        if not self.selects and (request.rows is not None or request.first_seed != 1):
            raise ConfigError(f'--rows, --first-seed: {self.name} has neither')
        return Size(duration_s, seeds)


@dataclass(frozen=True)
class Outcome:
    """Result of an experiment: its runs, tables and files."""

    experiment: str
    tables: list[Table]
    manifest: dict[str, Any]
    files: list[Path]


def run(experiment: Experiment, request: Request, out: Path, update: Update) -> Outcome:
    """Result of an experiment, run and written to files.

    Parameters
    ----------
    experiment, request : Experiment, Request
    out : Path
        Folder, made if it is not there.
    update : callable
        Called with the number of finished runs and the total.
    """
    size = experiment.size(request)
    columns = list(request.columns or experiment.suite.present(experiment.columns))
    plan = experiment.plan(request, size, columns)
    start = time.monotonic()
    with opened(out) as store:
        begin(store, resume=request.resume)
        tasks = tasks_of(plan, experiment.suite.run_job)
        kept = sum(task.key in store.rows for task in tasks)
        workers = Workers(request.jobs, request.scheduler)
        results = run_jobs(tasks, workers, store, update, experiment.suite.run_job)
        tables = experiment.tables(results, size, request)
        long = experiment.suite.long_table(experiment.name, results, experiment.paper)
        files = _write_tables(experiment.name, tables, long, out)
        files += _write_figures(experiment.figures(results, size, request), out)
        manifest = _manifest(experiment, request, size, plan, results, time.monotonic() - start)
        files.append(store.finish([task.key for task in tasks]))
        manifest['rows'] = {'kept': kept, **_made_by(store)}
    manifest['files'] = [f.name for f in files]
    path = out / 'manifest.json'
    path.write_text(json.dumps(manifest, indent=1, allow_nan=False) + '\n', encoding='utf-8')
    return Outcome(experiment.name, tables, manifest, [*files, path])


def _made_by(store: Store) -> dict[str, dict[str, int]]:
    """Sources and processors that made the rows, each with how many."""
    rows = store.rows.values()
    return {
        'sources': dict(Counter(row.made_by for row in rows)),
        'cpus': dict(Counter(row.cpu for row in rows)),
    }


def _write_tables(name: str, tables: Sequence[Table], long: Table, out: Path) -> list[Path]:
    """Write one Markdown file with all tables, and a CSV file with every unrounded number."""
    markdown, csv = out / f'{name}.md', out / f'{name}.csv'
    markdown.write_text('\n'.join(t.to_markdown() for t in tables), encoding='utf-8')
    csv.write_text(long.to_csv(), encoding='utf-8')
    return [markdown, csv]


def _write_figures(figures: Mapping[str, Figure], out: Path) -> list[Path]:
    from ..report.style import color, drawing

    files = []
    for name, figure in figures.items():
        for suffix in ('png', 'svg'):
            path = out / f'{name}.{suffix}'
            with drawing(name):
                metadata = {'Date': None} if suffix == 'svg' else None
                figure.savefig(path, dpi=80, facecolor=color('card'), metadata=metadata)
            files.append(path)
    return files


def _manifest(
    experiment: Experiment,
    request: Request,
    size: Size,
    plan: Sequence[Any],
    results: Sequence[RunResult],
    wall_s: float,
) -> dict[str, Any]:
    """Manifest as values for JSON: the request, versions, and the numbers of every run."""
    return record(
        {
            'experiment': experiment.name,
            'about': experiment.doc,
            'made': f'{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC',
            'command': sys.argv[1:],
            'quick': request.quick,
            'duration_s': size.duration_s,
            'seeds': list(range(request.first_seed, request.first_seed + size.seeds)),
            'choices': experiment.suite.choices(request),
            'recorded_imu': str(request.recorded or ''),
            **experiment.suite.describe(plan),
            'runs': [_run(r) for r in results],
            'wall_s': wall_s,
            'processes': request.jobs,
            'versions': run_info.versions(),
            'python': platform.python_version(),
            'platform': platform.platform(),
            'cpu': run_info.cpu_model(),
            'package': _package(),
            'git_commit': run_info.git_commit(_SOURCES),
        }
    )


def _run(result: RunResult) -> dict[str, object]:
    return {
        'group': result.group,
        'filter': result.column,
        'seed': result.seed,
        'stopped_s': result.stopped_s,
        'reason': result.reason,
        'fixes': result.verdicts,
        'filter_processor_s': result.seconds,
        'metrics': result.metrics,
    }


def _package() -> str:
    from importlib import metadata

    try:
        return metadata.version('polar_nav_tools')
    except metadata.PackageNotFoundError:
        return 'from sources'
