"""Runs of one follower of a bag: as recorded, replayed with configurations, verified.

A replay takes the arrays of a bag where that is possible, and its messages else, or where they are
to be compared.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ..bags.arrays import load_estimates, load_receipts
from ..bags.model import load_model_run
from ..bags.reader import Bag
from ..series.run import RunSeries
from ..series.vehicle import TruthSeries
from .arrays import SinsArrays, StationArrays
from .arrays_from_bag import load_arrays
from .by_array import replay_arrays
from .by_message import Progress, ReplayResult, replay
from .recorded import RecordedInputs, load_inputs
from .result import ReplayedRun
from .verification import VerifyResult, verify

Say = Callable[[str], None]


@dataclass
class Replays:
    """Recorded inputs of one follower, loaded once for any number of replays.

    Parameters
    ----------
    source : SinsArrays, StationArrays or RecordedInputs
        Inputs as arrays, or as messages.
    """

    source: SinsArrays | StationArrays | RecordedInputs
    _as_recorded: ReplayResult | None = field(default=None, init=False)

    @property
    def truth(self) -> TruthSeries | None:
        """Truth from the same pass over the bag; None if it was not read."""
        return None if isinstance(self.source, RecordedInputs) else self.source.truth

    def replayed(
        self, configurations: Sequence[str], say: Say, progress: Sequence[Progress | None]
    ) -> dict[str, ReplayedRun]:
        """Replayed runs by the name of their configuration."""
        runs = {}
        for configuration, share in zip(configurations, progress, strict=True):
            if sys.stderr.isatty():
                say(f'replaying with {configuration}')
            runs[configuration] = self._replayed(configuration, share)
        return runs

    def verified(self, say: Say) -> VerifyResult:
        """Comparison of a replay, with the recorded parameters, with the live outputs."""
        if not isinstance(self.source, RecordedInputs):
            raise TypeError('only a replay by message can be compared bit for bit')
        if sys.stderr.isatty():
            say('comparing a replay with what was published live')
        return verify(self.source, replayed=self._as_recorded)

    def _replayed(self, configuration: str, progress: Progress | None) -> ReplayedRun:
        if not isinstance(self.source, RecordedInputs):
            return replay_arrays(self.source, configuration=configuration, progress=progress)
        result = replay(self.source, configuration=configuration, progress=progress)
        if configuration == self.source.params.get('configuration'):
            self._as_recorded = result
        return result.as_run()


def load_replays(
    bag: Bag,
    vehicle: str,
    *,
    by_message: bool = False,
    truth: bool = False,
    progress: Progress | None = None,
) -> Replays:
    """Recorded inputs of a follower, by array if possible, else by message.

    Parameters
    ----------
    bag : Bag
    vehicle : str
    by_message : bool
        Load messages even where arrays would do: to compare bytes.
    truth : bool
        Load the truth in the same pass, if that is possible.
    progress : callable, optional
        Called with the share of the bag that was read.

    Raises
    ------
    BagError
        When the bag lacks what the engine needs.
    """
    arrays = None if by_message else load_arrays(bag, vehicle, truth=truth, progress=progress)
    return Replays(load_inputs(bag, vehicle) if arrays is None else arrays)


def recorded(bag: Bag, vehicle: str) -> RunSeries:
    """Series of the live run from its published messages, with the truth of the model.

    Raises
    ------
    BagError
        When the bag has no estimates of the vehicle.
    """
    return RunSeries(
        estimates=load_estimates(bag, vehicle),
        receipts=load_receipts(bag, vehicle),
        model=load_model_run(bag, vehicle),
    )
