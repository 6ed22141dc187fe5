"""Result of an identification: drag and current, and whether they may be used."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from ..arrays import Array


class IdentificationVerdict(IntEnum):
    """Verdict on an identification; the numbers are those of polar_nav_msgs/Identification."""

    ACCEPTED = 0
    NOT_EXCITED = 1
    UNPHYSICAL = 2
    NOT_CONVERGED = 3
    TOO_FEW_FIXES = 4


@dataclass(frozen=True)
class Identification:
    """Drag and current from a window of fixes.

    Attributes
    ----------
    stamp_ns : int
        Place in the order of events.
    method, trigger : str
        ``published`` or ``robust``; ``count``, ``nis``, ``command`` or ``offline``.
    reason : str
        One sentence with the numbers that decided.
    names, values, covariance : tuple of str, (n,), (n, n) arrays
        Parameters in SI units: drag_linear, drag_quadratic, current_x, current_y, ...
    condition_number : float
        Of the scaled normal matrix.
    """

    stamp_ns: int
    method: str
    verdict: IdentificationVerdict
    reason: str
    trigger: str
    fixes: int
    first_validity_ns: int
    last_validity_ns: int
    names: tuple[str, ...]
    values: Array
    covariance: Array
    condition_number: float
    cost: float
    iterations: int
