"""Rows of the DVL's scale beside a noisy IMU: by a speed that stays, not by the newest estimate.

The scale's rows are the predicted velocity. Where the accelerometers are noisy that jitters from
ping to ping, and the jitter passes for motion of the vehicle that the DVL does not show: a
regression on a noisy variable, which pulls the scale towards -1 and makes it look known
(docs/derivations/measurements.md, 1). A speed that stays as it is has no jitter.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import kernel
from ..watch import limited
from .rows import SCALE

NOISY = 1e-7
"""Variance density of the accelerometers [(m/s^2)^2/Hz] from which on a scale is pulled: that of
32 ug/sqrt(Hz), with which the pull is a tenth of what the scale can be known to."""
SWING = 0.25
"""What a velocity may be off the speed that stays [m/s]: what a vehicle swings by. The rest of a
change of speed shows in the rows at once."""
PINGS = 200.0
"""Pings that the speed that stays is the mean of at first, and in which it follows later."""
CREEP = 0.1
"""Rate at which it goes to the velocity while that is no further off than a swing, of the rate
beyond. A row that moves where the vehicle does not passes for motion, too."""
NUMBER = 3
"""Place of the number of pings so far, up to `PINGS`."""


@kernel
def steady_scale_rows(H: Array, R: Array, C_m_G: Array, P: Array, steady: Array) -> None:
    """Take from the rows of the DVL's scale what the velocity does about a speed that stays.

    A scale times that is noise of the ping. What goes beyond stands in the rows at the time at
    which the vehicle does it: rows that lag behind a swinging vehicle go along with its
    accelerations, which a latency shows as well.

    Parameters
    ----------
    H, R : (3, 24), (3, 3) arrays, in place
        Of a ping, as `rows.dvl_rows` leaves them.
    C_m_G : (3, 3) array
        Instrument to grid axes.
    P : (24, 24) array
    steady : (4,) array, in place
        The speed that stays, over 1 + scale, instrument axes [m/s], and pings so far.
    """
    for k in range(3):
        variance = P[SCALE + k, SCALE + k]
        if not variance > 0.0:
            continue
        now = 0.0
        for i in range(3):
            now -= C_m_G[i, k] * H[i, SCALE + k]
        off = now - steady[k]
        swing = limited(off, SWING)
        if steady[NUMBER] < PINGS:
            steady[k] += off / (steady[NUMBER] + 1.0)
        else:
            steady[k] += (off - swing + CREEP * swing) / PINGS
        off = now - steady[k]
        swing = limited(off, SWING)
        for i in range(3):
            H[i, SCALE + k] = -C_m_G[i, k] * (now - swing)
            for j in range(3):
                R[i, j] += C_m_G[i, k] * variance * swing * swing * C_m_G[j, k]
    steady[NUMBER] = min(steady[NUMBER] + 1.0, PINGS)
