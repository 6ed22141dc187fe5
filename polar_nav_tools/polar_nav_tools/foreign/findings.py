"""What is wrong with a recording: found before anything is integrated, or by the run itself."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.errors import PolarNavError

from ..bags.finding import Finding, Severity
from ..bags.missing import stamp_text
from ..scoring import Column, Table
from .sources import Stamps

NAMES: dict[str, str] = {
    'stamps_zero': 'stamps are zero: nobody filled in the header',
    'stamps_backwards': 'stamps run backwards against the order of the recording',
    'stamps_repeated': 'several messages share a stamp',
    'stamps_jump': 'stamps leave a gap that the recording does not have',
    'gap': 'no message for a while',
    'stamps_drift': 'stamps run faster or slower than the clock of the recording',
    'stamps_apart': 'stamps are of another time than those of the IMU',
    'rate_low': 'too few samples per second',
    'not_finite': 'a number is NaN or infinite',
    'stuck': 'the same numbers again and again',
    'imu_zero': 'rates or specific forces are zero in every message',
    'gravity_units': 'specific force has not the size of gravity',
    'gravity_sign': 'specific force points down at rest: it must point up',
    'gravity_direction': 'specific force does not point up on average',
    'gyro_units': 'rates and the turning of gravity differ by a factor',
    'gyro_sign': 'rates and the turning of gravity have opposite signs',
    'rate_size': 'angular rates no underwater vehicle has',
    'covariance_zero': 'a covariance is zero: it would claim perfect knowledge',
    'covariance_not_finite': 'a covariance has NaN or infinite numbers',
    'covariance_negative': 'a covariance is not positive definite',
    'velocity_size': 'velocities no underwater vehicle has',
    'velocity_invalid': 'pings without bottom lock',
    'depth_size': 'depths that cannot be',
    'depth_in_air': 'depths above the surface',
    'pressure_size': 'pressures that cannot be',
    'position_size': 'positions that are not near the surface of the earth',
    'position_invalid': 'messages that say they hold no position',
    'fix_from_future': 'fixes received before they were valid',
    'fix_clock': 'fixes whose delay is so long that their stamps are of another clock',
    'fix_late': 'fixes older than the filter takes',
    'fix_not_delayed': 'fixes that are received when they are valid',
    'noise_not_stated': 'the noise of the IMU is not stated',
    'gyrocompass': 'the gyros cannot find north',
    'not_at_rest': 'the vehicle moves while it should be at rest for alignment',
    'path_length': 'the paths by reference and by DVL have very different lengths',
    'truth_attitude': 'the reference has no attitude or velocity to compare with',
    'dvl_lever': 'in turns, the DVL is at another place or older than stated',
    'dvl_misfit': 'in the run, the DVL did not fit the IMU',
    'depth_misfit': 'in the run, depths did not fit the rest',
    'fixes_misfit': 'in the run, most fixes were refused by the gate',
}
"""Every kind of finding; the names are those of ``--accept``."""


def finding(
    name: str,
    severity: Severity,
    topic: str,
    stamp_ns: int | None,
    count: int,
    value: float,
    text: str,
) -> Finding:
    """Return a finding of a kind that ``--accept`` knows.

    Parameters
    ----------
    name : str
        Kind, a key of `NAMES`.
    severity : Severity
        With ``SEVERE`` the run is refused.
    topic : str
    stamp_ns : int or None
        Where it begins.
    count : int
        Messages that have it.
    value : float
        The number found, in the unit that the sentence states.
    text : str
        A sentence with number and limit, and what to change in the mapping where that is known.
    """
    if name not in NAMES:
        raise ValueError(f'{name!r} is no kind of finding')
    return Finding(severity, name, topic, stamp_ns, value, text, count)


def to_dict(found: Finding) -> dict[str, object]:
    """Return plain values for JSON."""
    return {
        'name': found.name,
        'severity': found.severity.name.lower(),
        'topic': found.topic,
        'stamp_ns': found.stamp_ns,
        'count': found.count,
        'value': found.value,
        'text': found.text,
    }


class Refused(PolarNavError):
    """Data that would be integrated to a wrong result; `details` has the findings."""

    def __init__(self, path: object, findings: Sequence[Finding]) -> None:
        names = ', '.join(dict.fromkeys(f.name for f in findings))
        options = ' '.join(f'--accept {n}' for n in dict.fromkeys(f.name for f in findings))
        super().__init__(
            f'{path}: refused, nothing was integrated: {names}. Correct the mapping, or take the '
            f'data as they are with {options}'
        )
        self.findings = tuple(findings)
        self.details = [f'{f.topic}: {f.name}: {f.text}' for f in findings]


def refusals(findings: Iterable[Finding], accepted: Iterable[str]) -> list[Finding]:
    """Return the severe findings that nobody accepted."""
    taken = set(accepted)
    return [f for f in findings if f.severity is Severity.SEVERE and f.name not in taken]


def table(findings: Sequence[Finding]) -> Table:
    """Show findings, the worst first."""
    columns = (
        Column('severity', 'severity'),
        Column('topic', 'topic'),
        Column('name', 'finding'),
        Column('when', 'first at'),
        Column('count', 'messages'),
        Column('text', 'what'),
    )
    rows = tuple(
        {
            'severity': f.severity.name.lower(),
            'topic': f.topic,
            'name': f.name,
            'when': '' if f.stamp_ns is None else stamp_text(f.stamp_ns),
            'count': f.count,
            'text': f.text,
        }
        for f in sorted(findings, key=lambda f: -f.severity)
    )
    return Table('What was found in the data', columns, rows)


def finding_at(
    name: str,
    severity: Severity,
    topic: str,
    where: NDArray[np.bool_],
    stamps_ns: Stamps,
    value: float,
    text: str,
) -> Finding:
    """Return a finding about the messages at ``where``, told by the first of them."""
    first = int(stamps_ns[int(np.flatnonzero(where)[0])])
    return finding(name, severity, topic, first, int(where.sum()), value, text)
