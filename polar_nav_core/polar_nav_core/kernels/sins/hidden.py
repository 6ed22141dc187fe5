"""What is estimated but not published: the errors of a leader, or of measured headings."""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from .state import NAVIGATION
from .update import USBL, N


@kernel
def leave_out_leader(P: Array, flat: Array) -> None:
    """Clear the last three states, the USBL error, of an estimate: the leader's are not its own.

    Parameters
    ----------
    P : (24, 24) array, or of the leading states, in place
    flat : (30,) array or longer, in place
        Leading values of the state.
    """
    for k in range(USBL, N):
        flat[NAVIGATION - N + k] = 0.0
    for k in range(USBL, P.shape[0]):
        for j in range(P.shape[0]):
            P[k, j] = 0.0
            P[j, k] = 0.0
