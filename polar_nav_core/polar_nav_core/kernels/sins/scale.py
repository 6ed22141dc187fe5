"""Rows of the DVL's scale under vibration: by a calm velocity, not by the newest estimate.

The scale's rows are the predicted velocity. Where the accelerometers are noisy that jitters from
ping to ping by more than a ping's own noise, and the jitter passes for motion of the vehicle that
the DVL does not show: a regression on a noisy variable, which pulls the scale towards -1 and makes
it look known (docs/derivations/measurements.md, 1). A mean over many pings has none of that.
"""

from __future__ import annotations

import math

from ...arrays import Array
from ..cache import kernel
from ..watch import limited
from .rows import DV, SCALE

NOISY = 1e-6
"""Variance density of the accelerometers [(m/s^2)^2/Hz] from which on velocity jitters: that of
100 ug/sqrt(Hz)."""
PINGS = 50.0
"""Pings that the mean is of."""
SIGMAS = 3.0
"""The mean is held within so many sigmas of the velocity, the scale being given: a vehicle that
changes its speed moves it at once."""
NUMBER = 3
"""Place of the number of pings in the mean."""


@kernel
def calm_scale_rows(H: Array, C_m_G: Array, P: Array, calm: Array) -> None:
    """Replace the newest velocity in the rows of the DVL's scale by a mean over pings before.

    Parameters
    ----------
    H : (3, 24) array, in place
        Of a ping, as `rows.dvl_rows` leaves it.
    C_m_G : (3, 3) array
        Instrument to grid axes.
    P : (24, 24) array
    calm : (4,) array, in place
        Mean of the predicted velocity over 1 + scale, instrument axes [m/s], and pings in it.
    """
    for k in range(3):
        now = 0.0
        variance = 0.0
        shared = 0.0
        for i in range(3):
            now -= C_m_G[i, k] * H[i, SCALE + k]
            shared += C_m_G[i, k] * P[DV + i, SCALE + k]
            for j in range(3):
                variance += C_m_G[i, k] * P[DV + i, DV + j] * C_m_G[j, k]
        if P[SCALE + k, SCALE + k] > 0.0:
            variance -= shared * shared / P[SCALE + k, SCALE + k]
        limit = SIGMAS * math.sqrt(max(variance, 0.0))
        used = now
        if calm[NUMBER] > 0.0:
            used += limited(calm[k] - now, limit)
        for i in range(3):
            H[i, SCALE + k] = -C_m_G[i, k] * used
        calm[k] = used + (now - used) / (calm[NUMBER] + 1.0)
    calm[NUMBER] = min(calm[NUMBER] + 1.0, PINGS - 1.0)
