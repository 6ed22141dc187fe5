"""Findings on the numbers of DVL, depth and positions, and what all sensors share."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array
from polar_nav_ros.adapters.arrays import finite_rows
from polar_nav_ros.adapters.position import PositionRows
from polar_nav_ros.adapters.sensors import IN_THE_AIR, DepthRows, DvlRows

from ..bags.finding import Finding, Severity
from .findings import finding, finding_at
from .fixes import FixRows
from .sources import Stamps

_MANY = 0.5
"""Share of messages above which a fault is the rule and not the exception."""
_FASTEST = 10.0
_WHOLE_S, _WHOLE_FEWEST = 10.0, 20
"""Depths that are equal over a whole recording, so long and so many, are of a stuck sensor."""
_LONGEST_DELAY_S = 3600.0
"""Fixes that are older on reception were stamped by another clock [s]."""
_DEEPEST, _HIGHEST = 11500.0, -20.0
_LOWEST_PRESSURE, _HIGHEST_PRESSURE = 3e4, 1.3e8
_UNIT_OF_PRESSURE = {'hPa': 1e2, 'kPa': 1e3, 'dbar': 1e4, 'bar': 1e5}


def check_finite(
    topic: str, stamps_ns: Stamps, finite: NDArray[np.bool_], what: str
) -> Iterator[Finding]:
    """Tell of messages with NaN or infinite numbers; they get a receipt and are not used."""
    bad = ~finite
    if bad.any():
        share = float(bad.mean())
        yield finding_at(
            'not_finite',
            Severity.SEVERE if share > _MANY else Severity.WARNING,
            topic,
            bad,
            stamps_ns,
            share,
            f'{int(bad.sum())} of {len(bad)} messages hold a {what} that is NaN or infinite',
        )


def check_stuck(
    topic: str, stamps_ns: Stamps, values: Array, *, limit_s: float, fewest: int
) -> Iterator[Finding]:
    """Look for runs of equal numbers, longer than a time [s] and a number of messages.

    A sensor's noise changes the last digits; numbers that stay equal are a driver that repeats.
    """
    same = (values[1:] == values[:-1]).all(axis=1)
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(np.int8)))
    starts, stops = edges[::2], edges[1::2]  # rows starts..stops are equal
    if not len(starts):
        return
    lasted = (stamps_ns[stops] - stamps_ns[starts]) * 1e-9
    bad = (lasted > limit_s) & (stops - starts + 1 >= fewest)
    if not bad.any():
        return
    worst = int(np.argmax(np.where(bad, lasted, -1.0)))
    total = float(lasted[bad].sum())
    span = float(stamps_ns.max() - stamps_ns.min()) * 1e-9
    yield finding(
        'stuck',
        Severity.SEVERE,
        topic,
        int(stamps_ns[starts[bad][0]]),
        int((stops - starts + 1)[bad].sum()),
        float(lasted[worst]),
        f'{int(bad.sum())} times the same numbers for up to {lasted[worst]:.3g} s (limit '
        f'{limit_s:g} s), {100 * total / max(span, 1e-9):.3g} % of the recording',
    )


def check_covariances(
    topic: str, stamps_ns: Stamps, covariance: Array, *, many_only: bool = False
) -> Iterator[Finding]:
    """Look for zero, NaN and indefinite matrices (n, 3, 3); `sigma` in a mapping replaces them."""
    if not len(covariance):
        return
    finite = finite_rows(covariance)
    zero = finite & (covariance == 0.0).all(axis=(1, 2))
    symmetric = np.where(finite[:, None, None], covariance, np.eye(3))
    symmetric = 0.5 * (symmetric + np.swapaxes(symmetric, 1, 2))
    negative = finite & ~zero & (np.linalg.eigvalsh(symmetric)[:, 0] <= 0.0)
    for name, bad, what in (
        ('covariance_zero', zero, 'all zeros'),
        ('covariance_not_finite', ~finite, 'NaN or infinite, or not known'),
        ('covariance_negative', negative, 'not positive definite'),
    ):
        if not bad.any():
            continue
        share = float(bad.mean())
        yield finding_at(
            name,
            Severity.WARNING if many_only and share <= _MANY else Severity.SEVERE,
            topic,
            bad,
            stamps_ns,
            share,
            f'{int(bad.sum())} of {len(bad)} covariances are {what}; `sigma` in the mapping '
            'states one',
        )


def check_dvl(dvl: DvlRows) -> Iterator[Finding]:
    """Look at velocities and their covariances."""
    topic, stamps_ns = dvl.topic, dvl.stamps_ns
    v, valid = dvl.velocity, dvl.valid
    if not valid.all():
        share = float((~valid).mean())
        yield finding_at(
            'velocity_invalid',
            Severity.WARNING if share > 0.1 else Severity.NOTE,
            topic,
            ~valid,
            stamps_ns,
            share,
            f'{int((~valid).sum())} of {len(valid)} pings have no bottom lock or no velocity',
        )
    if not valid.any():
        return
    yield from check_covariances(topic, stamps_ns[valid], dvl.covariance[valid])
    yield from check_stuck(topic, stamps_ns[valid], v[valid], limit_s=5.0, fewest=10)
    speed = np.linalg.norm(v, axis=1)
    fast = valid & (speed > _FASTEST)
    if fast.any():
        top = float(speed[fast].max())
        why = '; `unit: mm/s`?' if float(np.median(speed[valid])) > 100.0 else ''
        yield finding_at(
            'velocity_size',
            Severity.SEVERE if float(fast.sum()) > 0.01 * float(valid.sum()) else Severity.WARNING,
            topic,
            fast,
            stamps_ns,
            top,
            f'{int(fast.sum())} pings are faster than {_FASTEST:g} m/s, up to {top:.4g} m/s{why}',
        )


def check_depth(depth: DepthRows) -> Iterator[Finding]:
    """Look at depths, pressures and variances."""
    topic, stamps_ns = depth.topic, depth.stamps_ns
    yield from check_finite(topic, stamps_ns, np.isfinite(depth.depth), 'depth')
    good = np.isfinite(depth.depth)
    if not good.any():
        return
    if depth.pressure is not None:
        yield from _pressure(topic, stamps_ns[good], depth.pressure[good])
    median = float(np.median(depth.depth[good]))
    if not _HIGHEST < median < _DEEPEST:
        why = '; heights are `positive: up`' if -_DEEPEST < median < 0.0 else ''
        yield finding(
            'depth_size',
            Severity.SEVERE,
            topic,
            int(stamps_ns[0]),
            len(depth.depth),
            median,
            f'the median depth is {median:.4g} m (limits {_HIGHEST:g} to {_DEEPEST:g} m){why}',
        )
    else:
        yield from _in_the_air(topic, stamps_ns, depth.depth[good], depth.pressure)
    # A resting vehicle and a coarse sensor give equal numbers for a while; a driver that repeats
    # gives them for long, or from the first message to the last.
    whole = bool((depth.depth[good] == depth.depth[good][0]).all())
    yield from check_stuck(
        topic,
        stamps_ns[good],
        depth.depth[good, None],
        limit_s=_WHOLE_S if whole else 120.0,
        fewest=_WHOLE_FEWEST if whole else 100,
    )
    variance = depth.variance
    zero = variance == 0.0
    bad = ~np.isfinite(variance)
    negative = ~bad & (variance < 0.0)
    for name, where, what in (
        ('covariance_zero', zero, 'zero'),
        ('covariance_not_finite', bad, 'NaN or infinite'),
        ('covariance_negative', negative, 'negative'),
    ):
        if where.any():
            yield finding_at(
                name,
                Severity.SEVERE,
                topic,
                where,
                stamps_ns,
                float(where.mean()),
                f'{int(where.sum())} of {len(where)} variances are {what}; `sigma` in the mapping '
                'states one',
            )


def _in_the_air(
    topic: str, stamps_ns: Stamps, depth: Array, pressure: Array | None
) -> Iterator[Finding]:
    """Look for a vehicle above the surface; its shallowest hundredth counts, for it may dive."""
    least = float(np.quantile(depth, 0.01))
    if pressure is None:
        least, share, why = float(np.median(depth)), 'median', 'heights are `positive: up`'
    else:
        share = 'shallowest hundredth of the depths'
        why = 'of gauge pressures, `atmospheric_pressure: 0`; else state that of the place'
    if least < IN_THE_AIR:
        yield finding(
            'depth_in_air',
            Severity.WARNING,
            topic,
            int(stamps_ns[0]),
            len(depth),
            least,
            f'the {share} is {least:.4g} m, above the surface: {why}',
        )


def _pressure(topic: str, stamps_ns: Stamps, pressure: Array) -> Iterator[Finding]:
    median = float(np.median(pressure))
    if _LOWEST_PRESSURE < median < _HIGHEST_PRESSURE:
        return
    fits = [u for u, s in _UNIT_OF_PRESSURE.items() if _LOWEST_PRESSURE < median * s < 6e7]
    why = f'; unit {" or ".join(fits)}?' if fits else ''
    yield finding(
        'pressure_size',
        Severity.SEVERE,
        topic,
        int(stamps_ns[0]),
        len(pressure),
        median,
        f'the median pressure is {median:.4g} Pa (limits {_LOWEST_PRESSURE:g} to '
        f'{_HIGHEST_PRESSURE:g} Pa absolute){why}',
    )


def check_positions(rows: PositionRows) -> Iterator[Finding]:
    """Look for positions that cannot be, and for messages that hold none."""
    if not rows.given.all():
        share = float((~rows.given).mean())
        none = not rows.given.any()
        yield finding_at(
            'position_invalid',
            Severity.SEVERE if none else Severity.WARNING,
            rows.topic,
            ~rows.given,
            rows.stamps_ns,
            share,
            f'{int((~rows.given).sum())} of {len(rows.given)} messages hold no position: NaN, or '
            f'a status of no fix{"; leave the topic out of the mapping" if none else ""}',
        )
    far = ~rows.plausible
    if far.any():
        yield finding_at(
            'position_size',
            Severity.SEVERE,
            rows.topic,
            far,
            rows.stamps_ns,
            float(far.mean()),
            f'{int(far.sum())} of {len(far)} positions are not near the surface of the earth: '
            'degrees or radians, right `frame`?',
        )


def check_fixes(rows: FixRows, max_delay_s: float) -> Iterator[Finding]:
    """Look at delays, positions and covariances of fixes."""
    if rows.positions is not None:
        yield from check_positions(rows.positions)
    fixes = [f for f in rows.fixes if f.refusal is None]
    if not fixes:
        return
    validity = np.array([f.validity_ns for f in fixes], dtype=np.int64)
    delays_ns = np.array([f.receive_ns - f.validity_ns for f in fixes], dtype=np.int64)
    delay = np.asarray(delays_ns * 1e-9, dtype=np.float64)
    yield from check_covariances(rows.topic, validity, np.array([f.covariance_e for f in fixes]))
    if abs(float(np.median(delay))) > _LONGEST_DELAY_S:
        yield _other_clock(rows, validity, delay)
        return
    early = delay < 0.0
    if early.any():
        worst = float(-delay.min())
        yield finding_at(
            'fix_from_future',
            Severity.SEVERE,
            rows.topic,
            early,
            validity,
            worst,
            f'{int(early.sum())} fixes are received up to {worst:.4g} s before they are valid; '
            '`delay_s` states a delay, `time_offset_s` shifts the stamps',
        )
    late = delay > max_delay_s
    if late.any():
        worst = float(delay.max())
        yield finding_at(
            'fix_late',
            Severity.WARNING,
            rows.topic,
            late,
            validity,
            worst,
            f'{int(late.sum())} of {len(late)} fixes are older than max_delay_s = '
            f'{max_delay_s:g} s when received, up to {worst:.4g} s: they are not used',
        )
    if not early.any() and float(delay.max()) < 1e-3:
        yield finding(
            'fix_not_delayed',
            Severity.NOTE,
            rows.topic,
            int(validity[0]),
            len(fixes),
            float(delay.max()),
            'every fix is received when it is valid; if their stamps are those of arrival, '
            '`time_offset_s` shifts them back',
        )


def _other_clock(rows: FixRows, validity_ns: Stamps, delay_s: Array) -> Finding:
    median = float(np.median(delay_s))
    return finding(
        'fix_clock',
        Severity.SEVERE,
        rows.topic,
        int(validity_ns[0]),
        len(delay_s),
        median,
        f'fixes are received {median:.6f} s ({median / 86400.0:.3g} days) after their stamps '
        f'(median; limit {_LONGEST_DELAY_S:g} s): another clock, not a delay. `time_offset_s`, '
        'that number less the delay, shifts them; or `stamp: log` with `delay_s: 0.0` where there '
        'is no delay',
    )
