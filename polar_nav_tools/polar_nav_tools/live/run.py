"""One live run: graph of a mission, its processes, and the folder with bag and logs.

The folder of a run is its bag: ``<bags>/<name>/<name>_0.mcap`` and ``metadata.yaml`` of the
recorder, and ``run/`` with the parameter file and the log of every node.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from polar_nav_core.errors import ConfigError, PolarNavError

from ..bags.run_folder import OUTCOME_NAME, RUN_FOLDER
from ..graph.build import Graph, build_graph
from ..graph.options import GraphOptions
from ..graph.processes import processes_of
from .domain import graph_environment
from .run_info import run_info
from .supervisor import RunOutcome, RunStatus, Supervisor

if TYPE_CHECKING:
    from polar_nav_sim.mission import Mission


"""In the folder of a bag: logs and parameter files, and how the run ended."""


class RunFailed(PolarNavError):
    """A node died: its name, its end, and the path of its output."""

    def __init__(self, sentence: str, details: tuple[str, ...]) -> None:
        super().__init__(sentence)
        self.details = details


@dataclass(frozen=True)
class LiveRun:
    """Result of a run.

    Attributes
    ----------
    graph : Graph
        What ran.
    outcome : RunOutcome
        How it ended.
    domain_id : str
        ROS_DOMAIN_ID of its nodes.
    folder : Path
        Parameter files and logs of the nodes.
    bag : Path or None
        The recorded bag; None when nothing was recorded.
    """

    graph: Graph
    outcome: RunOutcome
    domain_id: str
    folder: Path
    bag: Path | None

    def check(self) -> None:
        """Raise RunFailed if a node died.

        Raises
        ------
        RunFailed
            Naming the node.
        """
        culprit = self.outcome.culprit
        if self.outcome.status is not RunStatus.FAILED or culprit is None:
            return
        sentence = f'{self.outcome.sentence}; its log is {self.folder / "logs" / culprit.log}'
        if self.bag is not None:
            sentence += f'; the bag so far is {self.bag}'
        raise RunFailed(sentence, culprit.last_lines)


def read_mission(name: str, duration_s: float | None, *, as_recorded: bool = False) -> Mission:
    """Mission by name or file, with another duration if stated.

    A mission along a track can be sailed with the track's own stamps (``as_recorded``).
    """
    from polar_nav_sim.mission import load_mission

    mission = load_mission(name)
    if as_recorded:
        mission = mission.with_overrides({'path.as_recorded': True})
    if duration_s is None:
        return mission
    try:
        return mission.with_duration(duration_s)
    except ConfigError as error:  # of a value that stands in no file
        _, named, why = str(error).partition('parameter duration_s: ')
        raise ConfigError(f'duration: {why}') if named else error from error


def new_bag_path(folder: Path, mission: str, seed: int, now: datetime) -> Path:
    """Path of a new bag: date, mission and seed, and a number if it exists."""
    stem = f'{now:%Y%m%d-%H%M%S}_{mission}_{seed}'
    path = folder / stem
    number = 2
    while path.exists() or _scratch(path).exists():
        path = folder / f'{stem}_{number}'
        number += 1
    return path


def prepare_graph(mission: Mission, options: GraphOptions, run_dir: Path) -> Graph:
    """Graph of a mission; the description of the run for the bag is written into ``run_dir``.

    Raises
    ------
    ConfigError
        When the bag exists already.
    """
    if options.bag is not None and options.bag.exists():
        raise ConfigError(f'{options.bag} exists already; a bag is never overwritten')
    run_dir.mkdir(parents=True, exist_ok=True)
    info_file = run_dir / 'run_info.json'
    state_file = run_dir / 'follower.state'
    graph = build_graph(mission, replace(options, run_info=info_file, state_file=state_file))
    info_file.write_text(json.dumps(run_info(mission, options, graph), indent=1), encoding='utf-8')
    return graph


def run_live(
    mission: Mission,
    options: GraphOptions,
    folder: Path,
    *,
    own_domain: bool,
    network: bool = False,
    on_start: Callable[[Graph, str], None] | None = None,
    on_progress: Callable[[float, float], None] | None = None,
    on_line: Callable[[str, str], None] | None = None,
    on_problem: Callable[[str], None] | None = None,
) -> LiveRun:
    """Result of a mission's graph, run until its end, a signal or the death of a node.

    Parameters
    ----------
    mission : Mission
        What is sailed.
    options : GraphOptions
        Pace, seed, configuration, and the bag to record to.
    folder : Path
        For logs and parameter files when nothing is recorded; otherwise they go into the bag's
        folder.
    own_domain : bool
        Keep to a ROS domain of its own unless the user has set one.
    network : bool
        Let other hosts see the graph; it keeps to the loopback interface otherwise.
    on_start : callable, optional
        Called with the graph and the domain id before the nodes start.
    on_progress, on_line, on_problem : callable, optional
        As in :class:`Supervisor`.

    Raises
    ------
    ConfigError
        When the bag exists already.
    """
    bag = options.bag
    run_dir = _scratch(bag) if bag is not None else folder
    graph = prepare_graph(mission, options, run_dir)
    env = graph_environment(run_dir, own_domain=own_domain, network=network)
    domain_id = env.get('ROS_DOMAIN_ID') or '0'
    if on_start is not None:
        on_start(graph, domain_id)
    supervisor = Supervisor(
        processes_of(graph),
        run_dir,
        env,
        on_progress=on_progress,
        on_line=on_line,
        on_problem=on_problem,
        truth_last=options.pace == 'realtime',
    )
    try:
        outcome = supervisor.run()
        (run_dir / OUTCOME_NAME).write_text(_outcome_json(outcome), encoding='utf-8')
    finally:
        if bag is not None and bag.is_dir():
            # The recorder makes the folder of the bag, so the logs can only move in now.
            run_dir = run_dir.rename(bag / RUN_FOLDER)
    recorded = bag if bag is not None and bag.is_dir() else None
    return LiveRun(graph, outcome, domain_id, run_dir, recorded)


def _outcome_json(outcome: RunOutcome) -> str:
    return json.dumps(
        {
            'status': outcome.status.value,
            'sentence': outcome.sentence,
            'wall_s': round(outcome.wall_s, 3),
            'counts': outcome.counts,
        },
        indent=1,
    )


def _scratch(bag: Path) -> Path:
    return bag.with_name(f'{bag.name}.run')
