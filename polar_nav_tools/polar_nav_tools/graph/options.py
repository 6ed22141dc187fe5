"""Options of a run: pace, seed, filter configuration, navigation of the leader."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from polar_nav_core.engine.configurations import NAMES
from polar_nav_core.errors import ConfigError

PACES = ('lockstep', 'realtime')
USUAL_CONFIGURATION = 'default'
"""Of the follower, where nobody names another."""
LEADERS = ('perfect', 'own')
"""Navigation of the leader: perfect, from the simulation as the papers assume, or its own."""
REALTIME_REORDER_S = 2.0
"""For a bag that is to equal the one of lockstep. Truth that was held up comes in bursts of up to
half a second, its topics in any order, and a packet goes through four processes: on a busy machine
they were 1.2 s behind the IMU."""
WATCHED_REORDER_S = 0.25
"""For a graph that is looked at: how old its estimates are. What comes later is refused."""
MAX_SEED = 2**31 - 1


@dataclass(frozen=True)
class GraphOptions:
    """Options of a run.

    Attributes
    ----------
    pace : str
        ``lockstep`` or ``realtime``.
    seed : int
        Of the run; every random stream is made from it and its own name.
    configuration : str
        Filter configuration of the follower.
    leader : str
        ``perfect``: leader_reference_node plays its navigation; ``own``: it navigates by itself.
    bag : Path or None
        Folder of the new bag; None: nothing is recorded.
    run_info : Path or None
        JSON file with the description of the run for the bag.
    respawn : bool
        Whether leader, link, follower and recorder are started again when they die: only at the
        pace ``realtime``, for in lockstep the counts of messages begin anew with a node.
    state_file : Path or None
        Where a follower that is started again finds its state.
    reorder_s : float
        Reorder window of the follower at the pace ``realtime`` [s]; lockstep has its own.
    composed : bool
        Whether the nodes of a vehicle share a process.
    max_bag_bytes : int
        Size at which a file of the bag ends and the next one begins; 0: never.

    Raises
    ------
    ConfigError
        For a value that does not exist.
    """

    pace: str = 'lockstep'
    seed: int = 1
    configuration: str = USUAL_CONFIGURATION
    leader: str = 'perfect'
    bag: Path | None = None
    run_info: Path | None = None
    respawn: bool = False
    state_file: Path | None = None
    reorder_s: float = REALTIME_REORDER_S
    composed: bool = False
    max_bag_bytes: int = 0

    def __post_init__(self) -> None:
        if self.pace not in PACES:
            raise ConfigError(f'pace {self.pace!r} is none of {", ".join(PACES)}')
        if self.configuration not in NAMES:
            known = ', '.join(NAMES)
            raise ConfigError(f'configuration {self.configuration!r} is none of {known}')
        if self.respawn and self.pace != 'realtime':
            raise ConfigError('nodes are started again at the pace realtime only')
        if self.leader not in LEADERS:
            raise ConfigError(f'leader {self.leader!r} is none of {", ".join(LEADERS)}')
        if not 0 <= self.seed <= MAX_SEED:
            raise ConfigError(f'seed {self.seed} is outside of [0, {MAX_SEED}]')
