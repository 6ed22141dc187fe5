"""Scores of estimated current and drag against the truth at the same stamps.

Total surge drag is scored at the mean speed of the window: d1 and d2 each are poorly known, and
strongly correlated, where the speed hardly changes; their sum at that speed is what navigation
needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..series.model import ModelRun, ModelSeries
from ..series.vehicle import Floats, TruthSeries
from .consistency import Consistency, consistency_along, whitened
from .drift_tables import CONFIGURATION
from .json_values import record
from .statistics import Statistics, statistics
from .tables import Column, Table
from .windows import SECOND_HALF, WHOLE, Window, standard_windows

DEGREE = 180.0 / np.pi
CURRENT_X, CURRENT_Y = 'current, grid east', 'current, grid north'
LINEAR, QUADRATIC, TOTAL = 'drag d1x', 'drag d2x', 'drag at mean speed'
HEADING = 'heading bias'


@dataclass(frozen=True)
class ModelErrors:
    """Estimates of one quantity beside their truth, shape (n,) each; NaN where not known."""

    unit: str
    estimate: Floats
    sigma: Floats
    truth: Floats

    @property
    def error(self) -> Floats:
        """Estimate minus truth."""
        return self.estimate - self.truth


@dataclass(frozen=True)
class QuantityScore:
    """Score of one quantity over one window."""

    unit: str
    truth: float  # mean
    final: float  # last estimate
    final_sigma: float
    error: Statistics
    normalized_rms: float  # RMS of error / sigma; 1 for an honest sigma

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        values = {
            'truth': self.truth,
            'final': self.final,
            'final_sigma': self.final_sigma,
            'normalized_rms': self.normalized_rms,
        }
        return {'unit': self.unit, **record(values), 'error': self.error.to_dict()}


@dataclass(frozen=True)
class ModelWindow:
    """Scores of drag and current over one part of a run."""

    window: Window
    quantities: dict[str, QuantityScore]
    nees: dict[str, Consistency]  # current, 2 degrees of freedom; drag, 2; heading bias, 1

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return {
            'quantities': {k: q.to_dict() for k, q in self.quantities.items()},
            'nees': {k: c.to_dict() for k, c in self.nees.items()},
        }


@dataclass(frozen=True, eq=False)
class ModelScore:
    """One run's model scored; `run` is kept for pictures and is not part of `to_dict`."""

    windows: dict[str, ModelWindow]
    run: ModelRun

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return {
            'windows': {name: w.to_dict() for name, w in self.windows.items()},
            'identifications': [
                record(
                    {
                        'stamp_ns': i.stamp_ns,
                        'method': i.method,
                        'verdict': i.verdict,
                        'reason': i.reason,
                        'trigger': i.trigger,
                        'fixes': i.fixes,
                        'values': i.values,
                        'sigmas': i.sigmas,
                    }
                )
                for i in self.run.identified
            ],
        }


def score_model(run: ModelRun, truth: TruthSeries) -> ModelScore:
    """Score of estimated drag and current over the whole run and its second half.

    Parameters
    ----------
    run : ModelRun
        Without a true model only the current can be compared.
    truth : TruthSeries
        Of the same vehicle; holds the true current.
    """
    windows = standard_windows(int(truth.stamp_ns.min()), int(truth.stamp_ns.max()))
    return ModelScore({w.name: _window(w, run, truth) for w in windows}, run)


def _window(window: Window, run: ModelRun, truth: TruthSeries) -> ModelWindow:
    rows = run.estimated.rows(window.mask(run.estimated.stamp_ns))
    found = model_errors(rows, run.truth, truth)
    return ModelWindow(
        window,
        {name: _quantity(errors) for name, errors in found.items()},
        _nees(rows, found),
    )


def model_errors(
    rows: ModelSeries, true_model: ModelSeries | None, truth: TruthSeries
) -> dict[str, ModelErrors]:
    """Errors of each quantity at the stamps of the estimates."""
    current_G = true_current(rows.stamp_ns, truth)
    found = {
        name: ModelErrors(
            'm/s', rows.current_G[:, k], _root(rows.P_current_G[:, k, k]), current_G[:, k]
        )
        for k, name in enumerate((CURRENT_X, CURRENT_Y))
    }
    speed = float(rows.v_r_b[:, 0].mean()) if len(rows) else float('nan')
    d1, d2 = _at(rows, true_model, 'drag_linear'), _at(rows, true_model, 'drag_quadratic')
    variance = (
        (speed * rows.drag_linear_sigma) ** 2
        + (speed**2 * rows.drag_quadratic_sigma) ** 2
        + 2.0
        * speed**3
        * rows.drag_correlation
        * rows.drag_linear_sigma
        * rows.drag_quadratic_sigma
    )
    total = rows.drag_linear * speed + rows.drag_quadratic * speed**2
    return found | {
        LINEAR: ModelErrors('N s/m', rows.drag_linear, rows.drag_linear_sigma, d1),
        QUADRATIC: ModelErrors('N s²/m²', rows.drag_quadratic, rows.drag_quadratic_sigma, d2),
        TOTAL: ModelErrors('N', total, _root(variance), d1 * speed + d2 * speed**2),
        HEADING: ModelErrors(
            '°',
            DEGREE * rows.heading_bias,
            DEGREE * rows.heading_bias_sigma,
            DEGREE * _at(rows, true_model, 'heading_bias'),
        ),
    }


def true_current(stamp_ns: np.ndarray, truth: TruthSeries) -> Floats:
    """True current (n, 3) [m/s] at n stamps, interpolated linearly."""
    since = (stamp_ns - truth.stamp_ns[0]) * 1e-9
    known = (truth.stamp_ns - truth.stamp_ns[0]) * 1e-9
    columns = [np.interp(since, known, truth.current_G[:, k]) for k in range(3)]
    return np.stack(columns, axis=1)


def _at(rows: ModelSeries, true_model: ModelSeries | None, name: str) -> Floats:
    """Newest truth at or before each estimate, before the first one the first; NaN without any."""
    if true_model is None or not len(true_model):
        return np.full(len(rows), np.nan)
    newest = np.searchsorted(true_model.stamp_ns, rows.stamp_ns, side='right') - 1
    return np.asarray(getattr(true_model, name)[np.maximum(newest, 0)])


def _quantity(e: ModelErrors) -> QuantityScore:
    nan = float('nan')
    known = np.isfinite(e.error) & np.isfinite(e.sigma) & (e.sigma > 0.0)
    ratio = e.error[known] / e.sigma[known]
    true = e.truth[np.isfinite(e.truth)]
    return QuantityScore(
        unit=e.unit,
        truth=float(true.mean()) if true.size else nan,
        final=float(e.estimate[-1]) if e.estimate.size else nan,
        final_sigma=float(e.sigma[-1]) if e.sigma.size else nan,
        error=statistics(e.error),
        normalized_rms=float(np.sqrt(np.mean(ratio**2))) if ratio.size else nan,
    )


def _nees(rows: ModelSeries, found: Mapping[str, ModelErrors]) -> dict[str, Consistency]:
    current = np.stack([found[CURRENT_X].error, found[CURRENT_Y].error], axis=1)
    drag = np.stack([found[LINEAR].error, found[QUADRATIC].error], axis=1)
    a, b = rows.drag_linear_sigma, rows.drag_quadratic_sigma
    ab = rows.drag_correlation * a * b
    P_drag = np.stack([np.stack([a * a, ab], axis=1), np.stack([ab, b * b], axis=1)], axis=1)
    heading = found[HEADING]
    errors = {
        'current, 2 dof': whitened(current, rows.P_current_G[:, :2, :2]),
        'drag d1x and d2x, 2 dof': whitened(drag, P_drag),
        'heading bias, 1 dof': whitened(heading.error[:, None], heading.sigma[:, None, None] ** 2),
    }
    return {k: consistency_along(v) for k, v in errors.items()}


def _root(variance: Floats) -> Floats:
    return np.sqrt(np.where(variance >= 0.0, variance, np.nan))


def model_table(models: Mapping[str, ModelScore]) -> Table:
    """Table of current and drag: estimate, sigma and error, second half."""
    columns = (
        CONFIGURATION,
        Column('what', 'what'),
        Column('unit', 'unit'),
        Column('truth', 'truth', doc='mean over the second half'),
        Column('final', 'at the end', doc='estimate'),
        Column('final_sigma', '± 1 sigma'),
        Column('rms', 'RMS error'),
        Column('max', 'largest error'),
        Column('normalized_rms', 'error/sigma', doc='RMS; 1 for an honest sigma'),
    )
    rows = tuple(
        {
            'configuration': name,
            'what': what,
            'unit': q.unit,
            'truth': q.truth,
            'final': q.final,
            'final_sigma': q.final_sigma,
            'rms': q.error.rms,
            'max': q.error.max,
            'normalized_rms': q.normalized_rms,
        }
        for name, one in models.items()
        for what, q in one.windows[SECOND_HALF].quantities.items()
    )
    return Table('Water and drag, second half', columns, rows)


def identification_table(models: Mapping[str, ModelScore]) -> Table:
    """Table of all identifications with their results."""
    columns = (
        CONFIGURATION,
        Column('at', 'at', 's', 5, 'since the start of the truth'),
        Column('method', 'method'),
        Column('trigger', 'trigger'),
        Column('fixes', 'fixes'),
        Column('verdict', 'verdict'),
        Column('drag_linear', 'd1x', 'N s/m'),
        Column('drag_quadratic', 'd2x', 'N s²/m²'),
        Column('current_x', 'current x', 'm/s'),
        Column('current_y', 'current y', 'm/s'),
        Column('reason', 'reason'),
    )
    rows = tuple(
        {
            'configuration': name,
            'at': (i.stamp_ns - one.windows[WHOLE].window.start_ns) * 1e-9,
            'method': i.method,
            'trigger': i.trigger,
            'fixes': i.fixes,
            'verdict': i.verdict,
            **{
                key: i.values.get(key)
                for key in ('drag_linear', 'drag_quadratic', 'current_x', 'current_y')
            },
            'reason': i.reason,
        }
        for name, one in models.items()
        for i in one.run.identified
    )
    return Table('Identifications', columns, rows)


def model_consistency(one: ModelScore | None) -> dict[str, Consistency]:
    """NEES of drag and current in the second half, for the table of consistency."""
    if one is None:
        return {}
    return {f'NEES {k}': c for k, c in one.windows[SECOND_HALF].nees.items() if c.count}
