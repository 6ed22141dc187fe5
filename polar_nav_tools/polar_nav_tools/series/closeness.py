"""Largest difference of two runs of one filter, in units of the filter's own sigma.

In: two series of estimates of the same inputs. Out: the largest difference, its time and field. It
compares machines and versions that round otherwise: their bits differ, and the question is whether
anything visible to a user differs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from polar_nav_core.attitude import log
from polar_nav_core.grid import ecef_to_grid

from .model import ModelSeries
from .vehicle import EstimateSeries, Floats

S = TypeVar('S', EstimateSeries, ModelSeries)

LIMIT_SIGMA = 1e-6
"""Differences up to this share of sigma are rounding."""
LIMIT_TEXT = '1e-6 sigma'

_BIASES = ('gyro_bias_b', 'accel_bias_b', 'dvl_scale_m', 'dvl_markov_m', 'usbl_bias_a')


@dataclass(frozen=True)
class Closeness:
    """The largest difference between two runs.

    Attributes
    ----------
    sigmas : float
        Of all fields and times: |difference| over sigma; inf where the runs cannot be paired, or
        one has a number and the other none.
    what : str
        Its field; a sentence if the runs cannot be paired.
    stamp_ns : int
        Its stamp [ns].
    fields : dict of str to float
        Largest per field.
    """

    sigmas: float
    what: str
    stamp_ns: int
    fields: dict[str, float]

    @property
    def close(self) -> bool:
        """Whether it is rounding only."""
        return self.sigmas <= LIMIT_SIGMA

    def to_dict(self) -> dict[str, object]:
        """Comparison as values for JSON; without a number if the runs cannot be paired."""
        largest = self.sigmas if self.sigmas < float('inf') else None
        return {'sigmas': largest, 'what': self.what, 'stamp_ns': self.stamp_ns}


def closeness(reference: EstimateSeries, other: EstimateSeries) -> Closeness:
    """Largest difference of two runs, estimate by estimate.

    Positions are compared in grid axes, attitudes by the rotation between them, covariances as
    ``|dP_ij| / sqrt(P_ii P_jj)``; sigma is the reference's.
    """
    return _largest(reference, other, _ratios)


def model_closeness(reference: ModelSeries, other: ModelSeries) -> Closeness:
    """Largest difference of two runs' vehicle model and water, as `closeness`."""
    return _largest(reference, other, _model_ratios)


def _largest(reference: S, other: S, compared: Callable[[S, S], dict[str, Floats]]) -> Closeness:
    """Largest ratio of all fields of two runs, paired by their stamps."""
    n = min(len(reference), len(other))
    apart = np.flatnonzero(reference.stamp_ns[:n] != other.stamp_ns[:n])
    if apart.size:
        stamp_ns = int(reference.stamp_ns[apart[0]])
        return Closeness(np.inf, 'the stamps of the estimates differ', stamp_ns, {})
    if len(reference) != len(other):
        longer = reference if len(reference) > n else other
        what = f'{len(reference)} estimates against {len(other)}'
        return Closeness(np.inf, what, int(longer.stamp_ns[n]), {})
    if not n:
        return Closeness(np.inf, 'there are no estimates', 0, {})
    ratios = {name: rows.max(axis=1) for name, rows in compared(reference, other).items()}
    fields = {name: float(rows.max()) for name, rows in ratios.items()}
    what = max(fields, key=lambda name: fields[name])
    row = int(np.argmax(ratios[what]))
    return Closeness(fields[what], what, int(reference.stamp_ns[row]), fields)


def _model_ratios(a: ModelSeries, b: ModelSeries) -> dict[str, Floats]:
    """Differences over sigma, one row per sample of the model."""
    out = {}
    for name, field in (('velocity through the water', 'v_r_b'), ('current', 'current_G')):
        P_a, P_b = getattr(a, f'P_{field}'), getattr(b, f'P_{field}')
        sigma = np.sqrt(np.diagonal(P_a, axis1=1, axis2=2))
        out[name] = _over(_difference(getattr(a, field), getattr(b, field)), sigma)
        scale = sigma[:, :, None] * sigma[:, None, :]
        out[f'covariance of {name}'] = _over(_difference(P_a, P_b), scale).reshape(len(a), -1)
    for name in ('drag_linear', 'drag_quadratic', 'heading_bias'):
        sigma = getattr(a, f'{name}_sigma')
        for field in (name, f'{name}_sigma'):
            values = _difference(getattr(a, field), getattr(b, field))
            out[field.replace('_', ' ')] = _over(values, sigma)[:, None]
    return out


def _ratios(a: EstimateSeries, b: EstimateSeries) -> dict[str, Floats]:
    """Differences over sigma, one row per estimate."""
    status = (a.status != b.status)[:, None].astype(np.float64)
    difference = {
        'position': np.einsum('nij,nj->ni', _axes(a.r_e), _difference(a.r_e, b.r_e)),
        'velocity': _difference(a.v_G, b.v_G),
        'attitude': _rotation(a.C_b_G, b.C_b_G),
    }
    out = {'status': _over(status, np.zeros_like(status))}
    for name, values in difference.items():
        P_a, P_b = getattr(a, f'P_{name}_G'), getattr(b, f'P_{name}_G')
        sigma = np.sqrt(np.diagonal(P_a, axis1=1, axis2=2))
        out[name] = _over(values, sigma)
        scale = sigma[:, :, None] * sigma[:, None, :]
        out[f'covariance of {name}'] = _over(_difference(P_a, P_b), scale).reshape(len(a), -1)
    for field in _BIASES:
        values = _difference(getattr(a, field), getattr(b, field))
        name = field[:-2]
        out[name.replace('_', ' ')] = _over(values, getattr(a, f'{name}_sigma'))
    return out


def _difference(a: Floats, b: Floats) -> Floats:
    """Difference b - a; 0 where neither is a number, inf where only one of them is."""
    out = b - a
    out[np.isnan(a) & np.isnan(b)] = 0.0
    out[np.isnan(out)] = np.inf
    return out


def _axes(r_e: Floats) -> Floats:
    """C_e_G; any axes where there is no position."""
    known = np.isfinite(r_e).all(1)
    out = np.tile(np.eye(3), (len(r_e), 1, 1))
    out[known] = ecef_to_grid(r_e[known])
    return out


def _rotation(C_a: Floats, C_b: Floats) -> Floats:
    """Rotation vector [rad] from one attitude to the other, as `_difference`."""
    known_a, known_b = (np.isfinite(C).all((1, 2)) for C in (C_a, C_b))
    out = np.zeros((len(C_a), 3))
    out[known_a != known_b] = np.inf
    both = known_a & known_b
    out[both] = log(C_b[both] @ np.swapaxes(C_a[both], 1, 2))
    return out


def _over(difference: Floats, sigma: Floats) -> Floats:
    """|difference| / sigma; 0 where nothing differs, inf where something does without a sigma."""
    size = np.abs(difference)
    out = np.where(size == 0.0, 0.0, np.inf)
    return np.divide(size, sigma, out=out, where=(size > 0.0) & (sigma > 0.0))
