"""Rows of the DVL's scale: by the velocity that the vehicle has, not by what jitters about it.

The scale's rows are the vehicle's velocity. An estimate of it has errors that the innovation
beside the row has, too, and the filter takes their product for a scale that the ping shows: the
predicted velocity pulls the scale one way, the measured one the other, and both make it look known
(docs/derivations/measurements.md, 1). A mean over pings before has none of that, and is blind to
manoeuvres. Used is the mean, and of what the newest velocity differs by the part that is more than
its own error.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from .rows import DV, SCALE

PINGS = 200.0
"""Pings that the mean is of."""
SIGMAS = 3.0
"""A difference of more sigmas is a manoeuvre at once, whatever the differences before were."""
OUTAGE_NS = 10_000_000_000
"""Without a ping for longer [ns] the mean begins anew: the vehicle may have changed its speed, and
its velocity is no longer known well enough to tell."""
GOOD = 16.0
"""Square of the innovation, per its variance, beyond which a ping says nothing of the velocity."""
MEAN, SPREAD, NUMBER = 0, 3, 6
"""Places in the memory: mean velocity, mean square of the differences, pings in them."""
STEADY = 7
"""Length of the memory."""


@kernel
def steady_scale_rows(
    H: Array, R: Array, z: Array, C_m_G: Array, P: Array, steady: Array, PHt: Array, S: Array
) -> None:
    """Replace the newest velocity in the rows of the DVL's scale by the vehicle's own.

    Parameters
    ----------
    H : (3, 24) array, in place
        Of a ping, as `rows.dvl_rows` leaves it.
    R, z : (3, 3), (3,) arrays
        Its noise and innovation, grid axes.
    C_m_G : (3, 3) array
        Instrument to grid axes.
    P : (24, 24) array
    steady : (7,) array, in place
        Memory: mean of the velocity over 1 + scale, instrument axes [m/s]; mean square of what it
        differed by [(m/s)^2]; pings in both.
    PHt, S : (3, 24), (3, 3) arrays
        P H^T, transposed, and H P H^T + R.
    """
    n = 1.0 / (steady[NUMBER] + 1.0)
    for k in range(3):
        now = 0.0
        innovation = 0.0
        with_scale = 0.0
        scale_seen = 0.0
        variance = 0.0
        seen = 0.0
        noise = 0.0
        total = 0.0
        for i in range(3):
            now -= C_m_G[i, k] * H[i, SCALE + k]
            innovation += C_m_G[i, k] * z[i]
            with_scale += C_m_G[i, k] * P[DV + i, SCALE + k]
            scale_seen += C_m_G[i, k] * PHt[i, SCALE + k]
            for j in range(3):
                c = C_m_G[i, k] * C_m_G[j, k]
                variance += c * P[DV + i, DV + j]
                seen += c * PHt[j, DV + i]
                noise += c * R[i, j]
                total += c * S[i, j]
        if P[SCALE + k, SCALE + k] > 0.0:  # the scale being given
            variance -= with_scale * with_scale / P[SCALE + k, SCALE + k]
            seen -= with_scale * scale_seen / P[SCALE + k, SCALE + k]
            total -= scale_seen * scale_seen / P[SCALE + k, SCALE + k]
        is_good = innovation * innovation <= GOOD * total
        if is_good:
            now -= seen / (total + noise) * innovation
        if steady[NUMBER] == 0.0:
            steady[MEAN + k] = now
        moved = now - steady[MEAN + k]
        spread = max(steady[SPREAD + k], moved * moved / (SIGMAS * SIGMAS))
        used = steady[MEAN + k]
        if spread > max(variance, 0.0):
            used += (1.0 - max(variance, 0.0) / spread) * moved
        if is_good:
            steady[MEAN + k] += n * moved
            steady[SPREAD + k] += n * (moved * moved - steady[SPREAD + k])
        for i in range(3):
            H[i, SCALE + k] = -C_m_G[i, k] * used
    steady[NUMBER] = min(steady[NUMBER] + 1.0, PINGS - 1.0)
