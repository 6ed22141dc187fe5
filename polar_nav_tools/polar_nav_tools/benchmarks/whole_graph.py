"""One run of a mission's graph for a benchmark, whose processes are looked at as it goes on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from polar_nav_core.errors import PolarNavError
from polar_nav_sim.mission import Mission

from ..graph.options import GraphOptions
from ..graph.processes import processes_of
from ..live.domain import graph_environment
from ..live.run import prepare_graph
from ..live.supervisor import RunOutcome, RunStatus, Supervisor


class Look(Protocol):
    """Called as the run goes on."""

    def __call__(self, now_s: float, total_s: float, pids: Mapping[str, int], /) -> None:
        """Look at processes by name, at a simulated time of the total [s]."""


def run_graph(mission: Mission, options: GraphOptions, folder: Path, look: Look) -> RunOutcome:
    """How a run came to its end; parameter files and logs of its nodes are in the folder.

    Raises
    ------
    ConfigError
        When the bag exists already.
    PolarNavError
        When the run did not come to the end of the mission.
    """
    graph = prepare_graph(mission, options, folder)
    supervisor = Supervisor(
        processes_of(graph),
        folder,
        graph_environment(folder),
        on_progress=lambda now_s, total_s: look(now_s, total_s, supervisor.pids()),
    )
    outcome = supervisor.run()
    if outcome.status is not RunStatus.COMPLETED:
        raise PolarNavError(outcome.sentence)
    return outcome
