"""Comparison of several configurations: the tables of demo, score and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..series.model import ModelRun
from ..series.vehicle import EstimateSeries, ReceiptRecord, TruthSeries
from .align import Mode
from .drift_tables import CONFIGURATION, age_table, drift_table, phase_table
from .honesty import HEADLINE_COLUMNS, headline, honesty_of, honesty_table
from .model import (
    ModelScore,
    identification_table,
    model_consistency,
    model_table,
    score_model,
)
from .score import Score, WindowScore, score
from .tables import Column, Table
from .verdicts import FUSED, in_order
from .windows import SECOND_HALF, WHOLE, Window

Run = tuple[TruthSeries, EstimateSeries, Sequence[ReceiptRecord]]

_ERROR_COLUMNS = (
    Column('phi_x_arcmin', 'φx', '′', doc='attitude error about grid east'),
    Column('phi_y_arcmin', 'φy', '′', doc='attitude error about grid north'),
    Column('phi_z_arcmin', 'φz', '′', doc='attitude error about the vertical: heading'),
    Column('v_x', 'v x', 'm/s', doc='velocity error, grid east'),
    Column('v_y', 'v y', 'm/s', doc='velocity error, grid north'),
    Column('r_x', 'r x', 'm', doc='position error, grid east'),
    Column('r_y', 'r y', 'm', doc='position error, grid north'),
)
_STATISTICS = {
    'rms': 'RMS',
    'median': 'Median of the magnitude',
    'p95': '95 % of the magnitude',
    'max': 'Largest magnitude',
    'mean': 'Mean, with sign',
}


@dataclass(frozen=True, eq=False)
class Comparison:
    """Scores by configuration name, in the order given.

    `models`: those of the runs in which the vehicle's model took part.
    """

    scores: dict[str, Score]
    models: dict[str, ModelScore] = field(default_factory=dict)

    def to_dict(self) -> dict[str, object]:
        """Plain data for JSON: one entry per configuration, figures of the demo table first."""
        return {
            name: {
                'summary': row,
                'honesty': [one.to_dict() for one in honesty_of(self.scores[name])],
                **self.scores[name].to_dict(),
                **({'model': self.models[name].to_dict()} if name in self.models else {}),
            }
            for name, row in zip(self.scores, self.table().records(), strict=True)
        }

    def table(self) -> Table:
        """Table of the demo: RMS over the run, cost of the delay, consistency."""
        columns = (
            CONFIGURATION,
            *_ERROR_COLUMNS,
            Column(
                'horizontal_second_half',
                '2-D, 2nd half',
                'm',
                doc='horizontal RMS of the second half',
            ),
            Column(
                'lag_expected',
                'lag if ignored',
                'm',
                doc='speed × mean delay of the fused fixes in the second half',
            ),
            *HEADLINE_COLUMNS,
            Column('fused', 'fused', doc='fixes used'),
            Column('received', 'of', doc='fixes with a verdict'),
            Column('available_percent', 'available', '%', 4, 'share of the run with an estimate'),
        )
        rows = []
        for name, one in self.scores.items():
            late = one.second_half
            rows.append(
                {
                    'configuration': name,
                    **_errors_of(one, WHOLE, 'rms'),
                    'horizontal_second_half': late.rms('horizontal'),
                    'lag_expected': late.lag.expected,
                    **headline(one),
                    'fused': one.verdicts.by_verdict.get(FUSED, 0),
                    'received': one.verdicts.total,
                    'available_percent': 100.0 * one.availability.share,
                }
            )
        return Table('RMS over the whole run', columns, tuple(rows))

    def error_table(self, window: str = WHOLE, statistic: str = 'rms') -> Table:
        """Table of one statistic of every component, along and across the track too.

        Parameters
        ----------
        window : str
            Name of a window that every score has.
        statistic : {'rms', 'median', 'p95', 'max', 'mean'}
        """
        if statistic not in _STATISTICS:
            raise ValueError(f'statistic={statistic!r} must be one of {sorted(_STATISTICS)}')
        columns = (
            CONFIGURATION,
            *_ERROR_COLUMNS,
            Column('r_z', 'r z', 'm', doc='position error, up'),
            Column('along', 'along', 'm', doc='along the true track; negative: behind'),
            Column('cross', 'cross', 'm', doc='to the left of the true track'),
            Column('horizontal', '2-D', 'm', doc='horizontal distance'),
        )
        rows = tuple(
            {
                'configuration': name,
                **_errors_of(one, window, statistic),
                **{
                    k: getattr(one.windows[window].components[k].error, statistic)
                    for k in ('r_z', 'along', 'cross', 'horizontal')
                },
            }
            for name, one in self.scores.items()
        )
        part = {WHOLE: 'whole run', SECOND_HALF: 'second half'}.get(window, window)
        return Table(f'{_STATISTICS[statistic]}, {part}', columns, rows)

    def delay_table(self) -> Table:
        """Table of the lag expected from ignoring the delay, and the error found, second half."""
        columns = (
            CONFIGURATION,
            Column('mean_delay', 'mean delay', 's', doc='of the fused fixes: receive - validity'),
            Column('mean_speed', 'mean speed', 'm/s', doc='true, horizontal'),
            Column('expected', 'lag if ignored', 'm', doc='mean speed × mean delay'),
            Column('found', '2-D RMS', 'm', doc='found, second half'),
            Column('along_mean', 'mean along', 'm', doc='negative: behind'),
            Column('ratio', 'found/expected'),
            Column('age_median', 'age, median', 's', doc='age of information'),
            Column('age_max', 'age, max', 's', doc='age of information'),
        )
        rows = []
        for name, one in self.scores.items():
            lag, age = one.second_half.lag, one.second_half.age
            rows.append(
                {
                    'configuration': name,
                    'mean_delay': lag.mean_delay,
                    'mean_speed': lag.mean_speed,
                    'expected': lag.expected,
                    'found': lag.found,
                    'along_mean': lag.along_mean,
                    'ratio': lag.ratio,
                    'age_median': age.median,
                    'age_max': age.max,
                }
            )
        return Table('What ignoring the delay costs, second half', columns, tuple(rows))

    def consistency_table(self) -> Table:
        """Table of NEES, NIS and heading against the filter's own covariance, second half."""
        columns = (
            CONFIGURATION,
            Column('what', 'what'),
            Column('count', 'samples'),
            Column('effective', 'effective', doc='independent samples among them'),
            Column('mean_per_dof', 'mean/dof', doc='1 for an honest covariance'),
            Column('band_low', 'band from', doc='95 % band of mean/dof'),
            Column('band_high', 'to', doc='95 % band of mean/dof'),
            Column('inside_percent', 'inside own band', '%', doc='95 % for an honest covariance'),
            Column('judgement', 'judgement'),
        )
        rows = []
        for name, one in self.scores.items():
            late = one.second_half
            kinds = {
                'NEES position, 3 dof': late.nees_position,
                'NEES horizontal, 2 dof': late.nees_horizontal,
                **{f'NIS of fixes from {k}': c for k, c in late.nis_fused.items()},
                **{
                    f'NIS of fixes from {k}, gated too': c
                    for k, c in late.nis.items()
                    if k not in late.nis_fused or c.count > late.nis_fused[k].count
                },
                **{_local_title(k, late): c for k, c in late.nis_local.items() if c.count},
                **model_consistency(self.models.get(name)),
            }
            for what, c in kinds.items():
                rows.append(
                    {
                        'configuration': name,
                        'what': what,
                        'count': c.count,
                        'effective': round(c.effective_count),
                        'mean_per_dof': c.mean_per_dof,
                        'band_low': c.band_low,
                        'band_high': c.band_high,
                        'inside_percent': 100.0 * c.share_inside,
                        'judgement': c.judgement,
                    }
                )
        note = (
            'NIS of DVL and depth: of the measurements used; inside own band: of their sums '
            'between two estimates. Errors along one run are correlated: the band of a NEES '
            'counts effective samples and is indicative; runs over many seeds are the test.'
        )
        return Table('Is the covariance honest? Second half', columns, tuple(rows), note)

    def verdict_table(self) -> Table:
        """Table of verdict counts; their sum is the number of received fixes."""
        verdicts = in_order(v for one in self.scores.values() for v in one.verdicts.by_verdict)
        columns = (
            CONFIGURATION,
            *(Column(v, v) for v in verdicts),
            Column('total', 'sum'),
            Column('revised', 'revised', doc='receipts replaced by a later revision'),
        )
        rows = tuple(
            {
                'configuration': name,
                **{v: one.verdicts.by_verdict.get(v, 0) for v in verdicts},
                'total': one.verdicts.total,
                'revised': one.verdicts.revised,
            }
            for name, one in self.scores.items()
        )
        return Table('What became of the fixes', columns, rows)

    def tables(self) -> tuple[Table, ...]:
        """All tables, in the order of importance."""
        return (*self.main_tables(), *self.more_tables())

    def main_tables(self) -> tuple[Table, ...]:
        """Main tables: errors, delay, consistency, verdicts."""
        return (
            self.table(),
            *self.model_tables(),
            self.delay_table(),
            self.verdict_table(),
            honesty_table(self.scores),
            self.consistency_table(),
        )

    def model_tables(self) -> tuple[Table, ...]:
        """Tables of current, drag and identifications, for runs with a vehicle's model."""
        found = (model_table(self.models), identification_table(self.models))
        return tuple(table for table in found if table.rows)

    def more_tables(self) -> tuple[Table, ...]:
        """Further tables: drift, age of the last fix, phases."""
        return (
            *(self.error_table(statistic=s) for s in ('median', 'p95', 'max')),
            drift_table(self.scores),
            *(t for t in (age_table(self.scores), phase_table(self.scores)) if t.rows),
        )


def compare(
    runs: Mapping[str, Run],
    *,
    models: Mapping[str, ModelRun] | None = None,
    phases: Sequence[Window] = (),
    mode: Mode = 'auto',
) -> Comparison:
    """Scores of all runs by name.

    Parameters
    ----------
    runs : mapping of str to (TruthSeries, EstimateSeries, sequence of ReceiptRecord)
        By the name that tables show, usually the filter configuration.
    models : mapping of str to ModelRun, optional
        Of the runs in which the vehicle's model took part.
    phases, mode
        As in `score`.
    """
    if not runs:
        raise ValueError('runs is empty: nothing to compare')
    return Comparison(
        {
            name: score(name, truth, estimate, receipts, phases=phases, mode=mode)
            for name, (truth, estimate, receipts) in runs.items()
        },
        {name: score_model(one, runs[name][0]) for name, one in (models or {}).items()},
    )


def _local_title(source: str, part: WindowScore) -> str:
    name = {'dvl': 'DVL'}.get(source, source)
    gated = part.gated_local[source]
    return f'NIS of {name}' + (f', {gated} gated besides' if gated else '')


def _errors_of(one: Score, window: str, statistic: str) -> dict[str, float]:
    """Values for `_ERROR_COLUMNS`."""
    components = one.windows[window].components
    return {
        c.key: getattr(components[c.key.removesuffix('_arcmin')].error, statistic)
        for c in _ERROR_COLUMNS
    }
