"""`polar demo`: run the graph, record it, replay with both filters, verify, score, report."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from polar_nav_core.engine.configurations import compared_of

from .analysis.analyse import Analysis, analyse
from .analysis.counts import topic_table
from .analysis.html_report import write_analysis
from .analysis.opening import open_for
from .graph.build import follower_parameters
from .graph.options import USUAL_CONFIGURATION, GraphOptions
from .live.run import LiveRun, new_bag_path, read_mission, run_live
from .scoring import Score
from .scoring.json_values import jsonable
from .scoring.windows import SECOND_HALF
from .terminal.progress import progress_display
from .terminal.tables import print_table

_RMS_KEYS = {
    'phi_x': 'phi_x_arcmin',
    'phi_y': 'phi_y_arcmin',
    'phi_z': 'phi_z_arcmin',
    'v_x': 'v_x_mps',
    'v_y': 'v_y_mps',
    'r_x': 'r_x_m',
    'r_y': 'r_y_m',
}


@dataclass(frozen=True)
class DemoOptions:
    """Options of a demo: mission, run, folder.

    Attributes
    ----------
    mission : str
        Name or file.
    duration_s : float or None
        Another length than the mission's own.
    seed, pace
        As in :class:`GraphOptions`.
    configuration : str or None
        Of the live follower; None: the usual one of the mission.
    bag : Path or None
        The new bag; by default a new one in ``folder``.
    folder : Path
        Where bags go.
    as_recorded : bool
        Sail a recorded track with its own stamps.
    leader : str
        As in :class:`GraphOptions`.
    network : bool
        Let other hosts see the graph.
    composed : bool
        As in :class:`GraphOptions`.
    """

    mission: str
    duration_s: float | None
    seed: int
    pace: str
    configuration: str | None
    bag: Path | None
    folder: Path
    as_recorded: bool = False
    leader: str = 'perfect'
    network: bool = False
    composed: bool = False


@dataclass(frozen=True, eq=False)
class DemoResult:
    """Result of a demo; without analysis and report if a signal ended the run."""

    run: LiveRun
    wall_s: dict[str, float]
    analysis: Analysis | None = None
    report: Path | None = None

    @property
    def signal(self) -> int | None:
        """The signal that ended the run."""
        return self.run.outcome.signal

    @property
    def complaints(self) -> list[str]:
        """Sentences about all defects of run and bag; empty if there are none."""
        return self.analysis.complaints() if self.analysis is not None else []

    def to_dict(self) -> dict[str, Any]:
        """Return figures as plain values for JSON."""
        analysis, graph = self.analysis, self.run.graph
        if analysis is None:
            raise ValueError('the run was interrupted: there are no figures')
        digests = {
            d.what: {'live': d.live, 'replay': d.replay, 'equal': d.equal}
            for d in analysis.digests()
        }
        return {
            'ok': not self.complaints,
            'path': str(self.run.bag),
            'complaints': self.complaints,
            'remarks': analysis.remarks(),
            'mission': graph.mission,
            'duration_s': graph.duration_s,
            'seed': graph.options.seed,
            'pace': graph.options.pace,
            'live_configuration': graph.options.configuration,
            'leader': graph.options.leader,
            'algorithms': {
                name: algorithm_figures(one) for name, one in analysis.comparison.scores.items()
            },
            'models': {
                name: one.windows[SECOND_HALF].to_dict()
                for name, one in analysis.comparison.models.items()
            },
            'counts': {
                c.topic: {'published': c.published, 'recorded': c.recorded, 'received': c.received}
                for c in analysis.counts
            },
            'counts_equal': all(c.equal for c in analysis.counts),
            'verify': {'equal': all(d.equal for d in analysis.digests()), 'sha256': digests},
            'report': str(self.report),
            'wall_s': {name: round(value, 2) for name, value in self.wall_s.items()},
        }

    def print_tables(self) -> None:
        """Print the figures for people on stdout."""
        from rich.console import Console

        if self.analysis is None:
            return
        console = Console(highlight=False)
        comparison = self.analysis.comparison
        for table in (
            comparison.table(),
            *comparison.model_tables(),
            comparison.delay_table(),
            comparison.verdict_table(),
            topic_table(self.analysis.counts),
        ):
            print_table(console, table)
        for digest in self.analysis.digests():
            verdict = 'equal' if digest.equal else '[red]different[/red]'
            console.print(f'{digest.what}: live and replay {verdict}')
            console.print(f'  live   sha256 {digest.live}')
            console.print(f'  replay sha256 {digest.replay}')
        for name, path in (('bag', self.run.bag), ('report', self.report)):
            console.print(f'{name:>6}  {path}', soft_wrap=True)
        steps = ', '.join(f'{name} {value:.1f} s' for name, value in self.wall_s.items())
        console.print(f'  wall  {steps}', soft_wrap=True)


def algorithm_figures(one: Score) -> dict[str, Any]:
    """Return the figures of one algorithm: RMS over the run, second half, verdicts."""
    half = one.second_half
    return {
        'rms': {key: jsonable(one.whole.rms(name)) for name, key in _RMS_KEYS.items()},
        'second_half': jsonable(
            {
                'horizontal_rms_m': half.rms('horizontal'),
                'r_x_m': half.rms('r_x'),
                'r_y_m': half.rms('r_y'),
                'mean_delay_s': half.lag.mean_delay,
                'mean_speed_mps': half.lag.mean_speed,
                'expected_lag_m': half.lag.expected,
            }
        ),
        'verdicts': dict(one.verdicts.by_verdict),
        'fixes': one.verdicts.total,
    }


def run_demo(options: DemoOptions, *, say: Callable[[str], None]) -> DemoResult:
    """Do all of it.

    Raises
    ------
    ConfigError
        For a mission, pace or configuration that does not exist.
    RunFailed
        When a node died.
    """
    started = time.monotonic()
    mission = read_mission(options.mission, options.duration_s, as_recorded=options.as_recorded)
    bag = options.bag or new_bag_path(options.folder, mission.name, options.seed, datetime.now())
    graph_options = GraphOptions(
        pace=options.pace,
        seed=options.seed,
        configuration=options.configuration or USUAL_CONFIGURATION,
        leader=options.leader,
        bag=bag,
        composed=options.composed,
    )
    with progress_display(mission.name, total=mission.duration_s, unit='s') as on_progress:
        run = run_live(
            mission,
            graph_options,
            bag,
            own_domain=True,
            network=options.network,
            on_start=lambda graph, domain: say(
                f'{mission.name}, {mission.duration_s:.0f} s: {len(graph.nodes)} nodes, pace '
                f'{options.pace} in ROS domain {domain}'
            ),
            on_progress=on_progress,
            on_problem=say,
        )
    run.check()
    wall_s = {'graph': run.outcome.wall_s}
    if run.outcome.signal is not None or run.bag is None:
        return DemoResult(run, wall_s)
    replaying = time.monotonic()
    algorithms = compared_of(follower_parameters(run.graph))
    analysis = analyse(open_for(run.bag, say), algorithms, verified=True, say=say)
    wall_s['replay and score'] = time.monotonic() - replaying
    drawing = time.monotonic()
    report = write_analysis(analysis, run.bag / 'report.html')
    wall_s['report'] = time.monotonic() - drawing
    wall_s['total'] = time.monotonic() - started
    sys.stderr.flush()
    return DemoResult(run, wall_s, analysis, report)
