"""What is known of a navigation that was lost and restored by itself."""

from __future__ import annotations

from dataclasses import dataclass

from .health.conditions import Condition, Culprit, Level, lately_s


@dataclass(frozen=True)
class Restored:
    """How often the newest sound state was restored, and the last time [ns] with its reason."""

    count: int
    stamp_ns: int
    why: str

    def conditions(self, stamp_ns: int) -> list[Condition]:
        """The condition at a stamp, if the last time was less than a minute before."""
        since_s = lately_s(stamp_ns, self.stamp_ns)
        if since_s is None:
            return []
        sentence = (
            f'{self.why}: restored from the newest sound state {since_s:.0f} s ago with enlarged '
            f'covariance ({self.count} times so far)'
        )
        return [Condition('restored', Level.ERROR, Culprit.UNEXPLAINED, sentence)]


NOT_RESTORED = Restored(0, 0, '')
