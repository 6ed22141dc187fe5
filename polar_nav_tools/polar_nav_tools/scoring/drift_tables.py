"""Tables of drift, of the error by age of the last fix, and of the error per phase."""

from __future__ import annotations

from collections.abc import Mapping

from .relative import INTERVAL_S
from .score import Score
from .tables import Column, Table
from .windows import SECOND_HALF, WHOLE

CONFIGURATION = Column('configuration', 'configuration')


def drift_table(scores: Mapping[str, Score]) -> Table:
    """Table of error per distance, absolute and relative error, availability."""
    columns = (
        CONFIGURATION,
        Column('distance', 'distance', 'm', 4, 'true way'),
        Column('final_error', '2-D at the end', 'm'),
        Column('final_percent', 'drift', '% of distance', doc='error at the end over distance'),
        Column('absolute_rms', 'absolute RMS', 'm', doc='in space, no alignment, as evo_ape'),
        Column('absolute_p95', 'absolute 95 %', 'm'),
        Column('absolute_max', 'absolute max', 'm'),
        Column(
            'relative_rms',
            f'relative RMS, {INTERVAL_S:g} s',
            'm',
            doc='error of the motion over an interval, as evo_rpe',
        ),
        Column('available_percent', 'available', '%', 4, 'share of the run with an estimate'),
        Column('longest_outage', 'longest outage', 's'),
        Column('first_after', 'first estimate after', 's'),
    )
    rows = tuple(
        {
            'configuration': name,
            'distance': one.drift.distance,
            'final_error': one.drift.final_error,
            'final_percent': one.drift.final_percent,
            'absolute_rms': one.absolute.rms,
            'absolute_p95': one.absolute.p95,
            'absolute_max': one.absolute.max,
            'relative_rms': one.relative.rms,
            'available_percent': 100.0 * one.availability.share,
            'longest_outage': one.availability.longest_outage,
            'first_after': one.availability.first_after,
        }
        for name, one in scores.items()
    )
    return Table('Drift and availability', columns, rows)


def age_table(scores: Mapping[str, Score]) -> Table:
    """Table of the position error by the age of the newest fix in the estimate."""
    columns = (
        CONFIGURATION,
        Column('from_s', 'age from', 's'),
        Column('to_s', 'to', 's'),
        Column('count', 'estimates'),
        Column('rms', '2-D RMS', 'm'),
        Column('median', 'median', 'm'),
        Column('p95', '95 %', 'm'),
        Column('max', 'max', 'm'),
        Column('sigma', 'stated sigma', 'm', doc="RMS of the filter's own horizontal sigma"),
    )
    rows = tuple(
        {
            'configuration': name,
            'from_s': part.from_s,
            'to_s': part.to_s,
            'count': part.horizontal.count,
            'rms': part.horizontal.rms,
            'median': part.horizontal.median,
            'p95': part.horizontal.p95,
            'max': part.horizontal.max,
            'sigma': part.sigma_rms,
        }
        for name, one in scores.items()
        for part in one.by_age
    )
    return Table('Horizontal error against the age of the last fix', columns, rows)


def phase_table(scores: Mapping[str, Score]) -> Table:
    """Table of errors per phase of the mission; empty if the mission has one phase only."""
    columns = (
        Column('phase', 'phase'),
        CONFIGURATION,
        Column('duration', 'duration', 's'),
        Column('rms', '2-D RMS', 'm'),
        Column('median', 'median', 'm'),
        Column('p95', '95 %', 'm'),
        Column('max', 'max', 'm'),
        Column('along', 'along, mean', 'm', doc='negative: behind'),
        Column('cross', 'cross, mean', 'm', doc='to the left'),
        Column('phi_z_arcmin', 'φz, RMS', '′'),
        Column('age_median', 'age, median', 's', doc='age of information'),
    )
    phases = dict.fromkeys(
        phase
        for one in scores.values()
        for phase in one.windows
        if phase not in (WHOLE, SECOND_HALF)
    )
    rows = []
    for phase in phases:
        for name, one in scores.items():
            part = one.windows.get(phase)
            if part is None:
                continue
            horizontal = part.components['horizontal'].error
            rows.append(
                {
                    'phase': phase,
                    'configuration': name,
                    'duration': part.window.duration,
                    'rms': horizontal.rms,
                    'median': horizontal.median,
                    'p95': horizontal.p95,
                    'max': horizontal.max,
                    'along': part.components['along'].error.mean,
                    'cross': part.components['cross'].error.mean,
                    'phi_z_arcmin': part.rms('phi_z'),
                    'age_median': part.age.median,
                }
            )
    return Table('Phases of the mission', columns, tuple(rows))
