"""Rows of a ping by an attitude error: a velocity whose own error says nothing to the innovation.

Those rows are a velocity. The measured one has the noise of its own ping in it, the predicted one
the error of the estimate: each goes along with the innovation that the row stands beside, and the
filter takes that for a heading which the ping shows. Between both, by the share of the innovation
that is the estimate's own error, it does not (docs/derivations/measurements.md, 1).
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from .rows import turn_rows


@kernel
def own_share(S: Array, R: Array) -> float:
    """Return the part of a ping's innovation that is the estimate's own error, 0 to 1.

    tr(S - R) over tr(S), of the two horizontal rows.

    Parameters
    ----------
    S, R : (3, 3) arrays
        H P H^T + R of a ping, as `rows.dvl_rows` leaves its rows, and its noise.
    """
    own = S[0, 0] - R[0, 0] + S[1, 1] - R[1, 1]
    return own / (S[0, 0] + S[1, 1]) if own > 0.0 else 0.0


@kernel
def known_turn_rows(H: Array, z: Array, v_G: Array, share: float) -> None:
    """Replace the measured velocity in the attitude's rows of a ping by v_G - share z.

    Parameters
    ----------
    H : (3, 24) array, in place
        Of a ping, as `rows.dvl_rows` leaves it.
    z : (3,) array
        Its innovation [m/s].
    v_G : (3,) array
        Estimated velocity, grid axes [m/s].
    share : float
        1 is the measured velocity, 0 the predicted one; `own_share` is between.
    """
    turn_rows(H, v_G[0] - share * z[0], v_G[1] - share * z[1], v_G[2] - share * z[2])
