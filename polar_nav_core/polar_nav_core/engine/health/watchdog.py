"""Conditions of a strapdown navigation, from innovations and refusals of each sensor.

Nothing here changes an estimate. What is compared: innovation memories (kernels.watch), refusals
in a row, ages of the aids, speed and depth. Where the evidence fits several causes, the sentence
says so and the culprit has several bits. Thresholds: docs/trust-and-hold.md.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...arrays import Array
from ...kernels import watch
from ...kernels.statistics import largest_share
from .compass import heading_conditions
from .conditions import Chronicle, Condition, Culprit, Health, Level, lately_s
from .led import Led
from .mounting import Mounting
from .radius import radius_95
from .runaway import Runaway, imu_noise
from .shared import beyond_stated
from .slow import led_by_fixes, slow_faults
from .statistics import Statistics, statistics
from .used_again import UsedAgain
from .view import Envelope, View

DVL, DEPTH, FIX = range(watch.STREAMS)
_NAMES = ('DVL', 'depth', 'position fixes')
_CULPRITS = (Culprit.DVL | Culprit.IMU, Culprit.DEPTH | Culprit.IMU, Culprit.FIXES)

FEWEST = 10.0
"""Effective attempts before a memory is judged."""
_BIAS = np.array([45.0, 40.0])
"""Chi-square (1) of a mean that is a WARN, per memory; four times that is an ERROR."""
SEVERE = 4.0
_RISE = (17.3, 17.3, 15.3)
"""Log likelihood ratio, of DVL, depth and fixes, that is a WARN: of a shift, of another scatter,
of neighbours that are alike.

In 20 h the sums grow 1.2e7, 4.3e6 and 1.9e6 times (16, 6 and 26 at 10, 10 and 1 Hz). Of
innovations as stated they exceed these together 0.9 times in that time by Lorden's bound; those of
shifts once in 400 h by the mean run length of Siegmund (1985), 2 exp(h + 1.17 d) / d^2 for a shift
d, where Lorden's bound has 30 h.
"""
_BLOCK_RISE = (8.5, 7.0, 7.0)
"""That of blocks that scatter more, by measurement: in 72 h as stated, of runs that share no
noise, the largest were 5.7, 5.1 and 4.2; of those beyond h 20 to 30 % were beyond h + 1.
"""
_CALM = 0.5
"""Mean NIS per degree of freedom of fixes below which they scatter far less than stated."""
_SIDEWAYS = 0.9
"""Mean share across track from which on refused pings are turned, or the heading is."""
_SCATTER_SIGMAS = 8.0
_REFUSED_SHARE = 0.5
_ROW, _ROW_S = 5, 1.5
"""Measurements refused one after the other, and the time that they take at least [s]: a navigation
that runs away is metres off before half of the last thirty are refused."""
_MISSING_SHARE = 0.05
"""Of the IMU samples, from which on it is said that some are missing."""
ALONE_S = 5.0
"""Without a DVL that was used for so long a navigation is alone with its IMU and the fixes."""


class Watchdog:
    """Watchdog of one navigation; `look` returns its health.

    Parameters
    ----------
    envelope : Envelope
    """

    def __init__(self, envelope: Envelope) -> None:
        self._envelope = envelope
        self._chronicle = Chronicle()
        self._runaway = Runaway()
        self._mounting = Mounting()
        self._led = Led()
        self._used_again = UsedAgain('DVL'), UsedAgain('depth')

    def look(self, view: View, others: list[Condition]) -> Health:
        """Judge a navigation at a stamp; ``others`` are conditions that were found elsewhere."""
        radius = radius_95(view.P_horizontal)
        found = [*others, *self._conditions(view), *_lost(radius, self._envelope)]
        dvl_ns, depth_ns, fix_ns = (int(used_ns) for used_ns in view.used_ns)
        return Health(
            view.stamp_ns,
            self._chronicle.note(view.stamp_ns, found),
            radius,
            view.resets,
            (dvl_ns, depth_ns, fix_ns),
        )

    def _conditions(self, view: View) -> list[Condition]:
        s = statistics(view.memories)
        found = [*_imu_gap(view, self._envelope), *_imu_missing(view), *_imu_shock(view)]
        found += _silences(view, self._envelope)
        found += imu_noise(view.imu_noise)
        found += heading_conditions(view.compass, view.stamp_ns, self._envelope.silent_after_s)
        for stream in (DVL, DEPTH):
            refusals = _refusals(view, s, stream)
            found += [*refusals, *self._used_again[stream].look(view.stamp_ns, refusals)]
        found += _leapt(view)
        too_fast = view.speed > self._envelope.max_speed
        contradicted = max(map(abs, s.grid_mean[DVL, watch.SHORT].tolist()))
        enough = s.number[DVL, watch.SHORT] >= FEWEST
        share = s.refused[DVL, watch.SHORT] if enough else 0.0
        found += self._runaway.look(view.stamp_ns, too_fast, share, contradicted)
        found += _reopened(view, FIX)
        found += beyond_stated(view.shared)
        found += self._mounting.look(view.stamp_ns, int(view.opened_ns[DVL]), view.shared)
        found += slow_faults(view.evidence, view.stamp_ns, view.P_horizontal)
        way = led_by_fixes(view.evidence, view.P_horizontal)
        found += self._led.look(view.stamp_ns, way, view.P_horizontal)
        biases = {stream: _local_bias(s, stream) for stream in (DVL, DEPTH)}
        biases[FIX] = _fix_bias(s)
        for stream in (FIX, DVL, DEPTH):
            found += biases[stream]
        for stream in (DVL, DEPTH, FIX):
            found += scatter(s, stream, early=True)
        for stream in (DVL, DEPTH, FIX):
            found += [] if biases[stream] else _alike(s, stream)
        if not view.leader_stated:
            found += _calm(s)
        return [*found, *outside(view, self._envelope)]


def _imu_gap(view: View, envelope: Envelope) -> list[Condition]:
    """A gap between IMU samples that was bridged not long ago."""
    gaps = view.gaps
    since_s = lately_s(view.stamp_ns, gaps.end_ns)
    if since_s is None:
        return []
    level = Level.ERROR if gaps.last_s > envelope.max_imu_gap_s else Level.WARN
    sentence = (
        f'IMU gap of {gaps.last_s:.1f} s ended {since_s:.0f} s ago and was bridged with enlarged '
        f'covariance ({gaps.number} so far)'
    )
    return [Condition('IMU gap', level, Culprit.IMU, sentence)]


def _imu_shock(view: View) -> list[Condition]:
    """An IMU sample that was half believed, not long ago."""
    since_s = lately_s(view.stamp_ns, view.shock_ns)
    if since_s is None:
        return []
    sentence = (
        f'an IMU sample leapt {since_s:.0f} s ago: the vehicle was struck, or the sample is '
        'wrong; attitude and velocity count as unsure by it'
    )
    return [Condition('IMU shock', Level.WARN, Culprit.IMU, sentence)]


def _imu_missing(view: View) -> list[Condition]:
    """A regular IMU that lacks samples, none of whose gaps need be long enough to be bridged."""
    share = view.gaps.missing
    if share <= _MISSING_SHARE:
        return []
    sentence = f'{100.0 * share:.0f} % of the IMU samples of the last 20 s are missing'
    return [Condition('IMU samples missing', Level.WARN, Culprit.IMU, sentence)]


def _silences(view: View, envelope: Envelope) -> list[Condition]:
    """Local sensors that were used once, and now are not; fixes: see engine.integrity."""
    found = []
    for stream in (DVL, DEPTH):
        since_s = (view.stamp_ns - int(view.used_ns[stream])) * 1e-9
        if view.used_ns[stream] and since_s > envelope.silent_after_s:
            name = _NAMES[stream]
            culprit = _CULPRITS[stream] & ~Culprit.IMU
            sentence = f'no {name} used for {since_s:.0f} s'
            found.append(Condition(f'{name} silent', Level.WARN, culprit, sentence))
    return found


def _refusals(view: View, s: Statistics, stream: int) -> list[Condition]:
    """A local sensor that the gate refuses, or whose gate had to be opened again."""
    name, culprit = _NAMES[stream], _CULPRITS[stream]
    share, number = s.refused[stream, watch.SHORT], s.number[stream, watch.SHORT]
    found = []
    mostly = number >= FEWEST and share > _REFUSED_SHARE
    if mostly or _in_a_row(view, stream):
        how = f'{100.0 * share:.0f} % of {name}'
        if not mostly:
            how = f'the newest {int(view.refused_row[stream])} {name}'
        sentence = f'{how} refused: {name} and inertial navigation disagree'
        if stream == DVL and abs(s.across[stream, watch.SHORT]) > _SIDEWAYS:
            culprit |= Culprit.HEADING
            sentence += ' across track: the heading is off, or the DVL is turned'
        found.append(Condition(f'{name} refused', Level.ERROR, culprit, sentence))
    return [*found, *_reopened(view, stream, culprit)]


def _in_a_row(view: View, stream: int) -> bool:
    """Whether a sensor that was used is refused measurement by measurement for a while."""
    since_s = (view.stamp_ns - int(view.used_ns[stream])) * 1e-9
    long = bool(view.used_ns[stream]) and since_s >= _ROW_S
    return long and int(view.refused_row[stream]) >= _ROW


def _reopened(view: View, stream: int, culprit: Culprit | None = None) -> list[Condition]:
    """A gate that had to be opened again not long ago."""
    since_s = lately_s(view.stamp_ns, view.opened_ns[stream])
    if since_s is None:
        return []
    name, verb = _NAMES[stream], 'were' if stream == FIX else 'was'
    sentence = (
        f'{name} {verb} refused until {since_s:.0f} s ago and {"are" if stream == FIX else "is"} '
        'used again with enlarged covariance'
    )
    blamed = _CULPRITS[stream] if culprit is None else culprit
    return [Condition(f'{name} reopened', Level.ERROR, blamed, sentence)]


def _leapt(view: View) -> list[Condition]:
    """A ping corrected more than an attitude that is right needs, not long ago."""
    since_s = lately_s(view.stamp_ns, view.leapt_ns)
    if since_s is None:
        return []
    sentence = (
        f'a DVL ping corrected attitude or velocity by far too much {since_s:.0f} s ago: the '
        'gyros missed a turn, or measured one that never was; the heading may be off'
    )
    return [Condition('DVL leapt', Level.ERROR, Culprit.IMU | Culprit.DVL, sentence)]


def is_alone(view: View) -> bool:
    """Whether no DVL was used lately: the IMU alone vouches against fixes."""
    return (view.stamp_ns - int(view.used_ns[DVL])) * 1e-9 >= ALONE_S


def refused_alone(condition: Condition, view: View) -> Condition:
    """The condition that fixes are refused; an ERROR where no DVL vouches for the estimate.

    Without one nothing but the fixes shows what an IMU makes of it that is worse than stated.
    """
    if not is_alone(view):
        return condition
    sentence = f'{condition.sentence}; no DVL vouches for the estimate'
    return replace(
        condition, level=Level.ERROR, culprit=Culprit.FIXES | Culprit.IMU, sentence=sentence
    )


def doubts_local(view: View) -> bool:
    """Whether the watchdog finds fault with DVL or IMU: these cannot vouch against fixes then."""
    s = statistics(view.memories)
    found = [*_refusals(view, s, DVL), *_local_bias(s, DVL), *scatter(s, DVL, early=True)]
    return bool(found)


def judged(s: Statistics, values: Array, rises: Array, stream: int) -> tuple[float, int, int]:
    """Largest share of a threshold that a mean or a shift reaches: share, memory, axis."""
    share, memory, axis = largest_share(
        s.number[stream], values[stream], rises[stream], FEWEST, _BIAS, _RISE[stream]
    )
    return float(share), int(memory), int(axis)


def _fix_bias(s: Statistics) -> list[Condition]:
    """Fixes that lie to one side: of the track (the DVL's fault) or of the map (the fixes')."""
    track, memory_t, axis_t = judged(s, s.track, s.track_rise, FIX)
    grid, memory_g, axis_g = judged(s, s.grid, s.grid_rise, FIX)
    worst = max(track, grid)
    if not worst > 1.0:
        return []
    level = Level.ERROR if worst > SEVERE else Level.WARN
    if axis_t == axis_g == 2:
        mean = s.track_mean[FIX, memory_t, 2]
        sentence = f'fixes lie {-mean:+.1f} sigma above the estimate: depth or fixes are off'
        culprit = Culprit.FIXES | Culprit.DEPTH
    elif track > 2.0 * grid:
        mean = s.track_mean[FIX, memory_t, axis_t]
        where = ('ahead', 'to port', 'above')[axis_t]
        cause = ('scale', 'turn', 'tilt')[axis_t]
        sentence = f'fixes lie {-mean:+.1f} sigma {where} whatever the course: {cause} of the DVL'
        culprit = Culprit.DVL
    elif grid > 2.0 * track:
        mean = s.grid_mean[FIX, memory_g, axis_g]
        where = ('grid east', 'grid north', 'up')[axis_g]
        sentence = f'fixes lie {-mean:+.1f} sigma towards {where} on every course: they drift'
        culprit = Culprit.FIXES
    else:
        mean = s.grid_mean[FIX, memory_g]
        size = float(np.hypot(mean[0], mean[1]))
        sentence = (
            f'fixes lie {size:.1f} sigma off on average: they drift, or the DVL has a scale error '
            'or is turned (on one course these look the same)'
        )
        culprit = Culprit.FIXES | Culprit.DVL
    return [Condition('fixes off', level, culprit, sentence)]


def _local_bias(s: Statistics, stream: int) -> list[Condition]:
    """A local sensor whose innovations have a mean: it, or the inertial navigation, is off."""
    worst, memory, axis = judged(s, s.track, s.track_rise, stream)
    if not worst > 1.0:
        return []
    level = Level.ERROR if worst > SEVERE else Level.WARN
    mean = s.track_mean[stream, memory, axis]
    where = 'up' if stream == DEPTH else ('along track', 'across track', 'up')[axis]
    sentence = (
        f'{_NAMES[stream]} innovations have a mean of {mean:+.1f} sigma {where}: '
        f'{_NAMES[stream]} or IMU'
    )
    return [Condition(f'{_NAMES[stream]} off', level, _CULPRITS[stream], sentence)]


def scatter(s: Statistics, stream: int, *, early: bool = False) -> list[Condition]:
    """A sensor that scatters more than stated; ``early`` looks at the cumulative sums, too."""
    sigmas = float(s.nis_sigmas[stream, watch.LONG])
    lasting = s.number[stream, watch.LONG] >= 5.0 * FEWEST and sigmas > _SCATTER_SIGMAS
    rising = early and max(s.noise_rise[stream].tolist()) > _RISE[stream]
    if not lasting and not rising:
        return []
    nis = float(s.nis[stream, watch.LONG if lasting else watch.SHORT])
    sentence = (
        f'{_NAMES[stream]} scatter {math.sqrt(nis):.1f} times as much as stated '
        f'(NIS {nis:.1f} per degree of freedom)'
    )
    culprit = _CULPRITS[stream] & ~Culprit.IMU
    return [Condition(f'{_NAMES[stream]} noise', Level.WARN, culprit, sentence)]


def _calm(s: Statistics) -> list[Condition]:
    """Fixes that scatter far less than stated."""
    nis = float(s.nis[FIX, watch.LONG])
    enough = s.number[FIX, watch.LONG] >= 5.0 * FEWEST and nis < _CALM
    if not enough or not max(s.calm_rise[FIX].tolist()) > _RISE[FIX]:
        return []
    sentence = (
        f'position fixes scatter far less than stated (NIS {nis:.2f} per degree of freedom): '
        'stated too carefully, or filtered before they came here'
    )
    return [Condition('fixes calm', Level.WARN, Culprit.FIXES, sentence)]


def _alike(s: Statistics, stream: int) -> list[Condition]:
    """A sensor whose innovations have something in common for a while that is no mean of them."""
    alike = stream != DEPTH and max(s.alike_rise[stream].tolist()) > _RISE[stream]
    if not alike and not max(s.block_rise[stream].tolist()) > _BLOCK_RISE[stream]:
        return []
    name = _NAMES[stream]
    them = 'depths' if stream == DEPTH else name
    sentence = (
        f'{them} have errors that last from one to the next: filtered before they came here, they '
        'wander, or what is between them (IMU, DVL) is worse than stated'
    )
    culprit = _CULPRITS[stream] | Culprit.DVL | Culprit.IMU
    return [Condition(f'{name} alike', Level.WARN, culprit, sentence)]


def outside(view: View, envelope: Envelope) -> list[Condition]:
    """A state that the vehicle cannot be in."""
    if view.speed > envelope.max_speed:
        sentence = f'{view.speed:.1f} m/s is faster than max_speed {envelope.max_speed:.1f} m/s'
        return [Condition('speed', Level.ERROR, Culprit.UNEXPLAINED, sentence)]
    if not -50.0 < view.depth < envelope.max_depth:
        sentence = f'{view.depth:.0f} m is no depth between the surface and max_depth'
        return [Condition('depth', Level.ERROR, Culprit.UNEXPLAINED, sentence)]
    return []


def _lost(radius: float, envelope: Envelope) -> list[Condition]:
    """A position whose 95 % radius is too large, or no number."""
    if radius <= envelope.lost_radius:
        return []
    sentence = (
        f'lost: the vehicle is within {radius:.0f} m with 95 %, lost_radius is '
        f'{envelope.lost_radius:.0f} m'
    )
    if math.isnan(radius):
        sentence = 'lost: the horizontal position has no covariance'
    return [Condition('lost', Level.ERROR, Culprit.UNEXPLAINED, sentence)]
