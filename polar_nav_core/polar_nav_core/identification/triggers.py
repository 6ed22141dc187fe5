"""Triggers of an identification: enough fixes, a high mean NIS, or a command."""

from __future__ import annotations

from collections import deque

from scipy.special import gammaincinv

from .params import IdentificationParams

COUNT, NIS, COMMAND, OFFLINE = 'count', 'nis', 'command', 'offline'
_HORIZONTAL = 2
"""Degrees of freedom of a fix."""


class Trigger:
    """Counts fixes and averages their NIS.

    A single large innovation is an outlier and asks for nothing; the mean over some fixes above
    its chi-square bound says that the model is wrong.
    """

    def __init__(self, params: IdentificationParams) -> None:
        """Trigger without any counted fix."""
        self._params = params
        self._fixes = 0
        self._since = 0
        self._full = False
        self._nis: deque[float] = deque(maxlen=params.identify_nis_fixes)
        self.bound = mean_nis_bound(params.identify_nis_fixes, params.identify_nis_probability)

    def add_fix(self) -> None:
        """Count a fix that went into the window."""
        self._fixes += 1
        self._since += 1

    def add_nis(self, nis: float) -> None:
        """Store the NIS of a fix, before the gate: two degrees of freedom."""
        self._nis.append(nis)

    @property
    def mean_nis(self) -> float:
        """Mean of the last fixes; NaN until there are enough."""
        if len(self._nis) < self._params.identify_nis_fixes:
            return float('nan')
        return sum(self._nis) / len(self._nis)

    def due(self) -> str | None:
        """Return ``count`` or ``nis`` if an identification is due, else None."""
        p = self._params
        if p.identify_method == 'none':
            return None
        if self._since >= p.identify_every if self._full else self._fixes >= p.identify_fixes:
            return COUNT
        enough = self._fixes >= p.identify_least_fixes and self._since >= p.identify_nis_fixes
        return NIS if enough and self.mean_nis > self.bound else None

    def done(self) -> None:
        """Reset the count after an identification with any verdict."""
        self._full = self._full or self._fixes >= self._params.identify_fixes
        self._since = 0
        self._nis.clear()


def mean_nis_bound(fixes: int, probability: float) -> float:
    """Bound of the mean NIS of a number of fixes: chi-square quantile over their number."""
    return 2.0 * float(gammaincinv(_HORIZONTAL * fixes / 2, probability)) / fixes
