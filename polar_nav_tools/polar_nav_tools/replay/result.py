"""Result of a replay in either mode, by message or by arrays."""

from __future__ import annotations

from dataclasses import dataclass

from polar_nav_follower.params import FollowerParams

from ..series.run import RunSeries

LOOK_EVERY_S = 10.0
"""How often the watchdog looks at a replay by arrays; one by message is looked at every second."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ReplayedRun(RunSeries):
    """Series of a replayed run; its model is without the truth.

    Attributes
    ----------
    vehicle : str
        The follower.
    params : FollowerParams
        Parameters used.
    taken : dict of str to int
        Messages taken per full topic name.
    verdicts : dict of str to int
        Verdict counts of everything that got a receipt.
    """

    vehicle: str
    params: FollowerParams
    taken: dict[str, int]
    verdicts: dict[str, int]

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of estimates and of receipts."""
        return len(self.estimates), len(self.receipts)
