"""Gate that opens again for refused measurements which have agreed with one another for long.

A gate judges by the filter's own covariance. Where that is wrong (a bias that has jumped, a
heading stated too well) every ping is refused, for good: the covariance grows by the stated noise,
the error faster. So a local sensor of which most of the last thirty attempts were refused, all of
the last minute to the same side, gets another chance if nothing speaks against it: it was never
believed before, or every other sensor is refused as well. Then P <- lambda P with lambda the NIS
per row of the measurement at hand, and it is judged anew. Scaling all of P keeps its correlations,
so that the next measurements correct tilt and biases as they would have at the start.

A sensor that agreed for long and now contradicts others that still agree is the one that is
wrong; its gate stays shut. Position fixes are not treated here (engine.engine).

DVL and depth know nothing of each other's errors: where most of both are refused, the inertial
navigation is what is wrong, and the DVL's gate opens as soon as the last thirty pings lie on one
side. Fixes need not be refused first, which come seldom and show a velocity late. If P is not
enough then, the velocity has jumped, or run away: it and the way since the last ping get the
variance of the innovation itself. What makes it run away is a wrong tilt, by which gravity leaks
into it (a turn that the gyros did not measure, or measured and never was): so tilt gets the
variance that explains the innovation by now. A gyro whose bias has jumped makes a tilt that grows:
the biases of the horizontal gyros get the variance that explains it, too. And the attitude may
have turned about up, which no ping shows: fixes find the heading.
"""

from __future__ import annotations

import math

from ...arrays import Array
from .. import watch
from ..cache import entry, kernel
from . import state as fs
from .gap import MOST_HEADING, MOST_TILT
from .settings import Settings
from .shared import clear_shared
from .signatures import clear_evidence
from .state import State
from .update import N, gain_of, nis_of
from .work import Work

FEWEST = 20.0
"""Attempts in the short memory before a gate may open."""
SHARE = 0.7
"""Share of them that must have been refused."""
LONG_FEWEST = 60.0
"""Attempts in the long memory before they can agree."""
AGREEMENT = 0.5
"""Share of the mean squared innovation that the squared mean must make up."""
NEVER_BELIEVED = 10
"""A sensor of which fewer were ever used has not been believed yet."""
LONG_BELIEVED = 300
"""A sensor of which as many were used has agreed for long."""
VOUCHING = 0.5
"""A sensor of which a smaller share is refused vouches for the navigation."""
CHANCES = 3
"""Times that a gate opens at once: what they do not mend is no matter of the covariance."""
LEAST, MOST = 2.0, 100.0
"""Limits of the factor on P."""
UP, VELOCITY, POSITION, GYRO_BIAS = 2, 3, 6, 9
"""The heading's error; first states of a kind."""
MOST_BIAS = 100.0
"""Most that a gyro's bias can have jumped, in its sigmas."""
VOUCHED_NS = 60_000_000_000
"""A fix vouches for the inertial navigation for so long."""
FIXES = 3
"""Fixes refused in a row that contradict the navigation together with a DVL."""
AGAIN_NS = 600_000_000_000
"""So long after the gate opened for the last time there is another chance."""
LEAP_TURN, LEAP = 0.1, 0.5
"""Turn about up [rad] and horizontal velocity [m/s] beyond which one ping's correction leaps."""
GRAVITY = 9.8
"""What leaks into the horizontal acceleration per radian of tilt [m/s^2]."""


@kernel
def opens(s: State, c: Settings, stream: int) -> bool:
    """Whether refused measurements of a local sensor agree for long enough to be believed.

    Never within ``c.reopen_ns`` of the last time, and not at all where that is 0.
    """
    if c.reopen_ns == 0 or stream == fs.FIX_ROW:
        return False
    since_ns = s.counters[fs.STAMP] - s.counters[fs.OPENED_NS + stream]
    if since_ns < c.reopen_ns:
        return False
    if s.counters[fs.OPENINGS + stream] >= CHANCES and since_ns < AGAIN_NS:
        return False
    row = s.memories[stream, watch.SHORT]
    weight = row[watch.WEIGHT]
    if weight < FEWEST or row[watch.REFUSED] < SHARE * weight:
        return False
    two = is_contradicted(s, stream)
    row = s.memories[stream, watch.SHORT if two else watch.LONG]
    weight = row[watch.WEIGHT]
    mean, square = 0.0, 0.0
    for k in range(3):
        mean += row[watch.GATE + k] * row[watch.GATE + k]
        square += row[watch.GATE_SQUARE + k]
    if weight < (FEWEST if two else LONG_FEWEST) or not mean > AGREEMENT * square * weight:
        return False
    return two or s.counters[fs.USES + stream] < NEVER_BELIEVED or not _vouched(s, stream)


@kernel
def is_backed(s: State, stream: int) -> bool:
    """Whether depths, which know nothing of a DVL's errors, contradict the navigation with it."""
    row = s.memories[fs.DEPTH_ROW, watch.SHORT]
    weight = row[watch.WEIGHT]
    return stream == fs.DVL_ROW and weight >= FEWEST and row[watch.REFUSED] >= SHARE * weight


@kernel
def is_contradicted(s: State, stream: int) -> bool:
    """Whether the inertial navigation with a DVL is contradicted by more than the DVL.

    Depths do so, or fixes refused in a row with a DVL that was believed (at the start either may
    be wrong), or an attitude that was wrong just now: fixes that hold velocity and position of one
    that has turned vouch for no heading.
    """
    return is_backed(s, stream) or (
        stream == fs.DVL_ROW
        and s.counters[fs.USES + stream] >= NEVER_BELIEVED
        and (s.counters[fs.REFUSED_ROW + fs.FIX_ROW] >= FIXES or _leapt_since(s))
    )


@kernel
def _leapt_since(s: State) -> bool:
    """Whether a ping has leapt not long ago, and since the DVL's gate was last opened."""
    leapt_ns = s.counters[fs.LEAPT_NS]
    lately = s.counters[fs.STAMP] - leapt_ns < AGAIN_NS
    return bool(lately and leapt_ns > s.counters[fs.OPENED_NS + fs.DVL_ROW])


@kernel
def may_begin_anew(s: State, c: Settings, stream: int) -> bool:
    """Whether a DVL whose gate was opened may say alone how fast the vehicle is.

    One that was believed may, but where the IMU may be noisier than stated: `runaway` sees to it.
    """
    believed = stream == fs.DVL_ROW and s.counters[fs.USES + stream] >= NEVER_BELIEVED
    return (believed and c.most_excess == 0.0) or is_backed(s, stream)


@kernel
def _vouched(s: State, stream: int) -> bool:
    """Whether fixes (for a depth also the DVL) agree with the navigation, against this sensor.

    A fix says so for a minute. A depth knows nothing of the horizontal velocity that a DVL
    contradicts.
    """
    since_ns = s.counters[fs.STAMP] - s.counters[fs.USED_NS + fs.FIX_ROW]
    found = since_ns <= VOUCHED_NS and agrees(s, fs.FIX_ROW)
    if stream == fs.DEPTH_ROW:
        found = found or agrees(s, fs.DVL_ROW)
    return found


@kernel
def agrees(s: State, stream: int) -> bool:
    """Whether a sensor is heard and less than half of it refused."""
    row = s.memories[stream, watch.SHORT]
    heard: bool = row[watch.WEIGHT] > 0.0
    return heard and row[watch.REFUSED] < VOUCHING * row[watch.WEIGHT]


@entry
@kernel
def inflate(s: State, factor: float) -> None:
    """P <- factor P."""
    for i in range(N):
        for j in range(N):
            s.P[i, j] *= factor


@kernel
def square_of(w: Work, m: int) -> float:
    """Squared length of the innovation in the scratch, m rows."""
    square = 0.0
    for k in range(m):
        square += w.z[k] * w.z[k]
    return square


@kernel
def turns_too_far(w: Work, m: int) -> bool:
    """Whether a judged ping would turn the attitude further than a linear correction can.

    Angles that the covariance holds for possible behind an opened gate explain any velocity.
    """
    gain_of(w.K, w.D, w.PHt, w.L, w.S, m)
    for k in range(3):
        turn = 0.0
        for a in range(m):
            turn += w.z[a] * w.K[a, k]
        if abs(turn) > (MOST_HEADING if k == UP else MOST_TILT):
            return True
    return False


@kernel
def begin_anew(s: State, w: Work, since_ns: int) -> None:
    """Let the judged ping alone say how fast the vehicle is, and tilt be as uncertain as it shows.

    P gets the variance of the innovation for the velocity, that of its way for the position, and
    for the tilt, and for the biases of the gyros, that of one that began at
    ``since_ns`` and has led to the innovation by now. With a velocity so far off, rows of attitude
    are those of another velocity; they are left out, what the tilt does to the ping goes to its
    noise, and the pings to come show it. The heading is doubted after the ping (`doubt_heading`).
    """
    _take_back(s, w)
    square = square_of(w, fs.VECTOR)
    since_s = (s.counters[fs.STAMP] - since_ns) * 1e-9
    for k in range(3):
        s.P[VELOCITY + k, VELOCITY + k] += square
        s.P[POSITION + k, POSITION + k] += square * since_s * since_s
    tilt = MOST_TILT
    if since_s > 0.0:
        tilt = min(tilt, math.hypot(w.z[0], w.z[1]) / (GRAVITY * since_s))
    speed2 = 0.0
    for k in range(3):
        speed2 += (s.v_G[k] - w.z[k]) * (s.v_G[k] - w.z[k])
    for k in range(2):
        s.P[k, k] += tilt * tilt
    _doubt_gyros(s, w, since_s)
    turned = max(s.P[0, 0], s.P[1, 1]) * speed2
    for a in range(fs.VECTOR):
        w.R[a, a] += turned
        for k in range(3):
            w.H[a, k] = 0.0


@kernel
def _take_back(s: State, w: Work) -> None:
    """Take back what `open_gate` has added to P, but for the gyros; w.M is P before.

    What a wrong attitude does is added by itself. Were accelerometers, DVL and USBL in doubt, too,
    pings beside it would teach them errors that no instrument has; and angles that grow tenfold
    with each opening are soon none that a linear filter can have.
    """
    for k in range(N):
        if s.P[k, k] > 0.0 and not GYRO_BIAS <= k < GYRO_BIAS + 3:
            factor = math.sqrt(w.M[k, k] / s.P[k, k])
            for j in range(N):
                s.P[k, j] *= factor
                s.P[j, k] *= factor


@kernel
def leaps(x: Array) -> bool:
    """Whether a ping's correction x (24,) is larger than that of an attitude that is right."""
    square: float = x[VELOCITY] * x[VELOCITY] + x[VELOCITY + 1] * x[VELOCITY + 1]
    return bool(abs(x[UP]) > LEAP_TURN or square > LEAP * LEAP)


@kernel
def note_leap(s: State, c: Settings, w: Work, refused: int) -> None:
    """Note a used ping that leaps and contradicts the covariance, or those ``refused`` before it.

    It passes a gate all the same where common errors of the DVL are large, in a fast turn, or the
    attitude has become unsure while others were refused. A turn that never was, or one that the
    gyros missed, begins so; how much of it is about up no ping shows. One whose gate was opened is
    known as that.
    """
    if not leaps(w.x) or s.counters[fs.USES + fs.DVL_ROW] < NEVER_BELIEVED:
        return
    opened = s.counters[fs.OPENED_NS + fs.DVL_ROW] == s.counters[fs.STAMP]
    own_nis = nis_of(w.L, w.z, w.w, fs.VECTOR)  # without the common errors
    if not opened and (refused > 0 or own_nis > c.gates[fs.VECTOR]):
        s.counters[fs.LEAPT_NS] = s.counters[fs.STAMP]


@kernel
def doubt_heading(s: State) -> None:
    """Let the heading be unknown after a ping that began anew, and the velocity turn with it.

    What was wrong with the attitude, a turn that the gyros missed or one that never was, may have
    been about up, too. A turn of both together is what pings do not show (`carried`): fixes do.
    """
    variance = MOST_HEADING * MOST_HEADING
    x, y = s.v_G[0] + s.carried[0], s.v_G[1] + s.carried[1]
    s.P[UP, UP] += variance
    s.P[VELOCITY, VELOCITY] += variance * y * y
    s.P[VELOCITY + 1, VELOCITY + 1] += variance * x * x
    s.P[VELOCITY, VELOCITY + 1] -= variance * x * y
    s.P[VELOCITY + 1, VELOCITY] -= variance * x * y
    s.P[UP, VELOCITY] += variance * y
    s.P[VELOCITY, UP] += variance * y
    s.P[UP, VELOCITY + 1] -= variance * x
    s.P[VELOCITY + 1, UP] -= variance * x


@kernel
def _doubt_gyros(s: State, w: Work, since_s: float) -> None:
    """Let the gyros' biases be as uncertain as makes tilt explain the innovation.

    A bias b that began ``since_s`` ago makes g b t^2 / 2 of velocity by now, and turns the heading
    by -b t. That of the vertical gyro shows in nothing yet, but it is of the same instrument. One
    that would have to be too large is none: a turn was. A DVL that has not agreed for long may be
    what is wrong, and says nothing of gyros.
    """
    if s.counters[fs.USES + fs.DVL_ROW] < LONG_BELIEVED:
        return
    most = 0.0
    for k in range(GYRO_BIAS, GYRO_BIAS + 3):
        most = max(most, MOST_BIAS * math.sqrt(s.P[k, k]))
    change = 0.5 * GRAVITY * since_s * since_s
    size = math.hypot(w.z[0], w.z[1])
    if change == 0.0 or size > most * change:
        return
    variance = (size / change) ** 2
    for k in range(3):
        s.P[GYRO_BIAS + k, GYRO_BIAS + k] += variance
        turned = -variance * since_s * s.C_b_G[UP, k]
        s.P[UP, GYRO_BIAS + k] += turned
        s.P[GYRO_BIAS + k, UP] += turned
    s.P[UP, UP] += variance * since_s * since_s


@kernel
def open_gate(s: State, w: Work, stream: int, m: int) -> None:
    """Enlarge P by the NIS per row of the judged measurement; the stream's memories begin anew."""
    inflate(s, min(max(w.nis[0] / m, LEAST), MOST))
    note_opening(s, stream)


@kernel
def note_opening(s: State, stream: int) -> None:
    """Count an opening of a gate; the stream's memories, and evidence of faults, begin anew."""
    for k in range(watch.MEMORIES):
        for j in range(watch.WIDTH):
            s.memories[stream, k, j] = 0.0
    clear_shared(s.shared)
    clear_evidence(s)
    s.counters[fs.REFUSED_ROW + stream] = 0
    s.counters[fs.OPENED_NS + stream] = s.counters[fs.STAMP]
    s.counters[fs.OPENINGS + stream] += 1
