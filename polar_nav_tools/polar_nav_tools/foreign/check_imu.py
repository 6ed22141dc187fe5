"""Findings on an IMU: gravity's size and sign, rates in degrees, stuck and missing numbers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_ros.adapters.arrays import chosen, finite_rows
from polar_nav_ros.adapters.sensors import ImuRows

from ..bags.finding import Finding, Severity
from .check_values import check_finite, check_stuck
from .findings import finding
from .sources import Stamps

_GRAVITY = 9.81
_SIZE_WARNING, _SIZE_SEVERE = 0.02, 0.1
"""Share by which the median of the specific force may differ from gravity."""
_UP_WARNING, _UP_SEVERE = 0.8, 0.5
"""Smallest part of the mean specific force that must be along body z."""
_STANDARD = {'g': 9.80665, 'mg': 9.80665e-3}
_RATE_LIMIT = 3.5
"""Of the 99 % quantile of the angular rate [rad/s]: 200 deg/s."""
_SLOWEST_HZ = 20.0
_WINDOW_S = 0.5
_FEW_WINDOWS = 20
_LEAST_TURN = 2e-3
"""RMS of the turning of gravity per window below which rates cannot be compared with it [rad]."""
_LEAST_CORRELATION = 0.6
_FACTOR = 3.0


def check_imu(imu: ImuRows) -> Iterator[Finding]:
    """Look at the numbers of an IMU, body axes and SI as the mapping says they are."""
    topic, stamps_ns = imu.topic, imu.stamps_ns
    good = finite_rows(imu.omega_ib_b) & finite_rows(imu.f_b)
    yield from check_finite(topic, stamps_ns, good, 'rate or specific force')
    if good.sum() < 2:
        return
    known_ns = chosen(stamps_ns, good)
    omega, f = chosen(imu.omega_ib_b, good), chosen(imu.f_b, good)
    if not (omega.any() and f.any()):
        yield _zero(topic, known_ns, omega, f)
        return
    for part in (omega, f):
        yield from check_stuck(topic, known_ns, part, limit_s=1.0, fewest=20)
    span = float(stamps_ns.max() - stamps_ns.min()) * 1e-9
    rate = (len(stamps_ns) - 1) / span if span > 0.0 else float('inf')
    if rate < _SLOWEST_HZ:
        yield finding(
            'rate_low',
            Severity.WARNING,
            topic,
            int(stamps_ns[0]),
            len(stamps_ns),
            rate,
            f'{rate:.3g} samples per second (limit {_SLOWEST_HZ:g}): fast turns are not seen',
        )
    yield from _gravity(topic, known_ns, f)
    size = float(np.quantile(_lengths(omega), 0.99))
    if size > _RATE_LIMIT:
        yield finding(
            'rate_size',
            Severity.SEVERE,
            topic,
            int(stamps_ns[0]),
            len(omega),
            size,
            f'1 % of the rates exceed {size:.4g} rad/s (limit {_RATE_LIMIT:g}); '
            '`gyro_unit: deg/s` if they are degrees',
        )
    yield from _turning(topic, known_ns, omega, f)


def _zero(topic: str, stamps_ns: Stamps, omega: Array, f: Array) -> Finding:
    both = not (omega.any() or f.any())
    what = 'specific force' if omega.any() else 'rate'
    text = 'the IMU is all zeros' if both else f'the {what} of the IMU is all zeros'
    return finding(
        'imu_zero',
        Severity.SEVERE,
        topic,
        int(stamps_ns[0]),
        len(f),
        0.0,
        f'{text}, {len(f)} messages: nothing was measured, another topic may hold it',
    )


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.sqrt(np.einsum('ni,ni->n', vectors, vectors)))


def _gravity(topic: str, stamps_ns: Stamps, f: Array) -> Iterator[Finding]:
    size = float(np.median(_lengths(f)))
    off = abs(size / _GRAVITY - 1.0)
    if off > _SIZE_WARNING:
        unit = next((u for u, s in _STANDARD.items() if abs(size * s / _GRAVITY - 1.0) < 0.1), '')
        why = f'; `accel_unit: {unit}` would make it {size * _STANDARD[unit]:.3f}' if unit else ''
        if not unit and size < 0.5 * _GRAVITY:
            why = '; gravity may have been taken out, which must not be'
        yield finding(
            'gravity_units',
            Severity.SEVERE if off > _SIZE_SEVERE else Severity.WARNING,
            topic,
            int(stamps_ns[0]),
            len(f),
            size,
            f'the median of the specific force is {size:.4g} m/s^2, gravity is '
            f'{_GRAVITY} m/s^2 (limit {100 * _SIZE_WARNING:g} %){why}',
        )
        if not unit and size < 0.5 * _GRAVITY:
            return
    mean = np.median(f, axis=0)
    up = float(mean[2] / max(float(np.linalg.norm(mean)), 1e-12))
    if up < -_UP_SEVERE:
        yield finding(
            'gravity_sign',
            Severity.SEVERE,
            topic,
            int(stamps_ns[0]),
            len(f),
            float(mean[2]),
            f'specific force along body z (up) is {mean[2]:+.3g} m/s^2, it must be about '
            f'{_GRAVITY:+.2f}; `rotation: frd` is of axes with z down, `flu` with z up',
        )
    elif up < _UP_WARNING:
        axis = int(np.argmax(np.abs(mean)))
        yield finding(
            'gravity_direction',
            Severity.SEVERE if up < _UP_SEVERE else Severity.WARNING,
            topic,
            int(stamps_ns[0]),
            len(f),
            up,
            f'only {up:.2f} of the specific force is along body z (limit {_UP_WARNING}); most, '
            f'{mean[axis]:+.3g} m/s^2, is along {"xyz"[axis]}: see `rotation`',
        )


def _turning(topic: str, stamps_ns: Stamps, omega: Array, f: Array) -> Iterator[Finding]:
    """Compare what the gyros say of the turning of gravity in the body with how it turned.

    Between windows, the direction u of specific force turns by du = -(integral of omega) x u where
    the vehicle accelerates little. The factor between both is 1 for rates in rad/s, 57 for degrees
    taken as radians, negative for a wrong sign.
    """
    factor, correlation, turn = turning_factor(stamps_ns, omega, f)
    if not np.isfinite(factor) or abs(correlation) < _LEAST_CORRELATION or turn < _LEAST_TURN:
        return
    if factor < 0.0:
        yield finding(
            'gyro_sign',
            Severity.SEVERE,
            topic,
            int(stamps_ns[0]),
            len(f),
            factor,
            f'by the gyros gravity turns {1 / factor:.3g} times as much as by the accelerometers '
            f'(correlation {correlation:.2f}): signs or axes of the two do not fit',
        )
    elif not 1.0 / _FACTOR < factor < _FACTOR:
        unit = '; `gyro_unit: deg/s`?' if 1 / 100 < factor < 1 / 30 else ''
        yield finding(
            'gyro_units',
            Severity.SEVERE,
            topic,
            int(stamps_ns[0]),
            len(f),
            1.0 / factor,
            f'by the gyros gravity turns {1.0 / factor:.3g} times as much as by the '
            f'accelerometers (limit {_FACTOR:g}, correlation {correlation:.2f}){unit}',
        )


def turning_factor(stamps_ns: Stamps, omega: Array, f: Array) -> tuple[float, float, float]:
    """Turning of gravity by the accelerometers over that by the gyros, and how sure it is.

    Returns
    -------
    factor : float
        Least squares over pairs of windows; NaN when there are too few.
    correlation : float
        Of both turnings.
    turn : float
        RMS turning by the accelerometers [rad].
    """
    nothing = float('nan'), 0.0, 0.0
    t = (stamps_ns - stamps_ns[0]) * 1e-9
    window = np.floor(t / _WINDOW_S).astype(np.int64)
    if len(window) == 0 or window.min() < 0 or window.max() > 10_000_000:
        return nothing
    counts = np.bincount(window)
    full = counts > 0.5 * np.median(counts[counts > 0])
    if full.sum() < _FEW_WINDOWS:
        return nothing
    with np.errstate(invalid='ignore', divide='ignore'):
        mean = [
            np.column_stack([np.bincount(window, a[:, i]) / counts for i in range(3)])
            for a in (omega, f)
        ]
        u = mean[1] / np.linalg.norm(mean[1], axis=1)[:, None]
    pairs = full[:-1] & full[1:]
    measured = (u[1:] - u[:-1])[pairs]
    rate = 0.5 * (mean[0][1:] + mean[0][:-1])[pairs]
    middle = 0.5 * (u[1:] + u[:-1])[pairs]
    predicted = -np.cross(rate, middle) * _WINDOW_S
    power = float(np.sum(predicted**2))
    total = float(np.sum(measured**2))
    if power <= 0.0 or total <= 0.0 or not np.isfinite(power * total):
        return nothing
    cross = float(np.sum(predicted * measured))
    turn = float(np.sqrt(total / max(len(measured), 1)))
    return cross / power, cross / float(np.sqrt(power * total)), turn
