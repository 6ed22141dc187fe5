"""Score of one run against its truth, as in tables, JSON and report.

In come the truth, the estimates and the receipts of one vehicle (polar_nav_tools.series.vehicle);
out comes a `Score`, plain numbers in the units that people read (arcmin, m/s, m).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.engine.outputs import LOCAL_DOF, LOCAL_GATED
from polar_nav_core.spilled import by_rows, give_back, parts

from ..series.vehicle import EstimateSeries, ReceiptRecord, TruthSeries
from .align import Alignment, AlignmentCounts, Mode, align
from .by_age import AgeClass, by_age
from .consistency import Consistency, consistency_along, whitened
from .errors import ARCMIN, ErrorSeries, distance_travelled, errors
from .json_values import record
from .relative import INTERVAL_S, absolute_errors, relative_errors
from .statistics import Statistics, statistics
from .timeliness import Availability, Lag, age_of_information, availability, delays
from .verdicts import (
    FUSED,
    VerdictCounts,
    VerdictSeries,
    count_verdicts,
    nis_by_source,
    nis_of_local,
)
from .windows import SECOND_HALF, WHOLE, Window, standard_windows

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

DEGREE = 180.0 / np.pi  # per radian


@dataclass(frozen=True)
class ComponentScore:
    """One error component over one window, with the filter's own sigma."""

    unit: str
    error: Statistics
    sigma_rms: float  # of the filter's own 1-sigma; NaN without one
    normalized_rms: float  # RMS of error / sigma; 1 for an honest sigma
    within_3_sigma: float  # share of samples

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        claims = record(
            {
                'sigma_rms': self.sigma_rms,
                'normalized_rms': self.normalized_rms,
                'within_3_sigma': self.within_3_sigma,
            }
        )
        return {'unit': self.unit, **self.error.to_dict(), **claims}


@dataclass(frozen=True)
class WindowScore:
    """Scores of one window of a run.

    `components`: phi_x, phi_y, phi_z, grid_heading [arcmin], true_heading [deg], v_x, v_y, v_z
    [m/s], r_x, r_y, r_z, along, cross, horizontal [m].
    """

    window: Window
    components: dict[str, ComponentScore]
    nees_position: Consistency  # 3 degrees of freedom
    nees_horizontal: Consistency  # 2 degrees of freedom
    nees_velocity: Consistency  # 3 degrees of freedom
    nees_heading: Consistency  # of the grid heading, 1 degree of freedom
    nis: dict[str, Consistency]  # by source, fused and gated fixes
    nis_fused: dict[str, Consistency]  # by source, fused fixes only
    nis_local: dict[str, Consistency]  # of 'dvl' and 'depth', those used
    gated_local: dict[str, int]  # of 'dvl' and 'depth', refused by the gate
    delay: Statistics  # of fused fixes [s]
    age: Statistics  # of information [s]
    lag: Lag

    def rms(self, component: str) -> float:
        """RMS of one component, in the component's unit."""
        return self.components[component].error.rms

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return {
            'start_ns': self.window.start_ns,
            'end_ns': self.window.end_ns,
            'components': {k: c.to_dict() for k, c in self.components.items()},
            'nees_position': self.nees_position.to_dict(),
            'nees_horizontal': self.nees_horizontal.to_dict(),
            'nees_velocity': self.nees_velocity.to_dict(),
            'nees_heading': self.nees_heading.to_dict(),
            'nis': {k: c.to_dict() for k, c in self.nis.items()},
            'nis_fused': {k: c.to_dict() for k, c in self.nis_fused.items()},
            'nis_local': {
                k: {**c.to_dict(), 'gated': self.gated_local[k]} for k, c in self.nis_local.items()
            },
            'delay_s': self.delay.to_dict(),
            'age_of_information_s': self.age.to_dict(),
            'lag': self.lag.to_dict(),
        }


@dataclass(frozen=True)
class Drift:
    """Horizontal error against the distance travelled."""

    distance: float  # true way from first to last scored sample [m]
    final_error: float  # 2-D, last scored sample [m]
    max_error: float  # [m]

    @property
    def final_percent(self) -> float:
        """Final error in % of distance; NaN without motion."""
        return 100.0 * self.final_error / self.distance if self.distance > 0.0 else float('nan')

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return record({**asdict(self), 'final_percent': self.final_percent})


@dataclass(frozen=True, eq=False)
class Score:
    """Score of one run; `pairs` and `errors`, kept for pictures, are not part of `to_dict`."""

    name: str
    windows: dict[str, WindowScore]
    alignment: AlignmentCounts
    availability: Availability
    verdicts: VerdictCounts
    drift: Drift
    absolute: Statistics  # distance between estimate and truth, as evo_ape [m]
    relative: Statistics  # over INTERVAL_S, as evo_rpe, translation [m]
    by_age: tuple[AgeClass, ...]
    pairs: Alignment
    errors: ErrorSeries

    @property
    def whole(self) -> WindowScore:
        """Scores of the whole run."""
        return self.windows[WHOLE]

    @property
    def second_half(self) -> WindowScore:
        """Scores of the second half by time, without the transient of the start."""
        return self.windows[SECOND_HALF]

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON."""
        return {
            'name': self.name,
            'windows': {k: w.to_dict() for k, w in self.windows.items()},
            'alignment': self.alignment.to_dict(),
            'availability': self.availability.to_dict(),
            'verdicts': self.verdicts.to_dict(),
            'drift': self.drift.to_dict(),
            'absolute_m': self.absolute.to_dict(),
            'relative_m': {'interval_s': INTERVAL_S, **self.relative.to_dict()},
            'by_age_of_information': [one.to_dict() for one in self.by_age],
        }


@np.errstate(over='ignore', invalid='ignore')  # a damaged message can hold any number
def score(
    name: str,
    truth: TruthSeries,
    estimate: EstimateSeries,
    receipts: Sequence[ReceiptRecord],
    *,
    phases: Sequence[Window] = (),
    mode: Mode = 'auto',
) -> Score:
    """Score of a run over the whole, its second half and further phases of the mission.

    Parameters
    ----------
    name : str
        What tables call it, usually the filter configuration.
    truth, estimate, receipts
        Of one vehicle and one run.
    phases : sequence of Window
        Scored besides the whole run and its second half; names must be new.
    mode : {'auto', 'exact', 'interpolate'}
        How truth and estimates are paired, see `align`.

    Raises
    ------
    ScoringError
        When nothing can be compared.
    """
    truth, estimate = truth.in_order(), estimate.in_order()
    pairs = align(truth, estimate, mode=mode)
    error = errors(pairs)
    verdicts = VerdictSeries.of(receipts)
    whole = _whole(pairs, error, estimate, verdicts)
    windows = standard_windows(int(truth.stamp_ns.min()), int(truth.stamp_ns.max()))
    taken = {w.name for w in windows}
    for phase in phases:
        if phase.name in taken:
            raise ValueError(f'phase {phase.name!r}: this name is taken')
        taken.add(phase.name)
    scored = np.flatnonzero(np.isfinite(error.horizontal))
    drift = Drift(
        distance=distance_travelled(pairs.truth.r_e),
        final_error=float(error.horizontal[scored[-1]]) if scored.size else float('nan'),
        max_error=float(error.horizontal[scored].max()) if scored.size else float('nan'),
    )
    return Score(
        name=name,
        windows={w.name: _window_score(w, whole) for w in (*windows, *phases)},
        alignment=pairs.counts,
        availability=availability(estimate, windows[0]),
        verdicts=count_verdicts(verdicts),
        drift=drift,
        absolute=statistics(absolute_errors(pairs)),
        relative=statistics(relative_errors(pairs)),
        by_age=by_age(error, whole.age),
        pairs=pairs,
        errors=error,
    )


class _Component(NamedTuple):
    """Error and sigma of one component in SI and radians, shape (n,), and its display unit."""

    unit: str
    factor: float
    values: Floats
    sigma: Floats


@dataclass(frozen=True, eq=False)
class _Whole:
    """Series of a whole run, of which each window uses rows; all in the order of stamps.

    All estimates count for `local`, not only those that truth can be compared with.
    """

    stamp_ns: Ints  # shape (n,)
    components: dict[str, _Component]
    speed: Floats  # true, horizontal, shape (n,) [m/s]
    age: Floats  # of information, shape (n,) [s]
    position: Floats  # whitened errors, shape (n, 3)
    horizontal: Floats  # whitened errors, shape (n, 2)
    velocity: Floats  # whitened errors, shape (n, 3)
    heading: Floats  # whitened errors, shape (n, 1)
    verdicts: VerdictSeries
    local_ns: Ints  # shape (m,)
    local: Floats  # EstimateSeries.local_statistics, shape (m, 2, 3)


def _whole(
    pairs: Alignment, error: ErrorSeries, estimate: EstimateSeries, verdicts: VerdictSeries
) -> _Whole:
    dr_G, P_G, v_G = error.dr_G, error.P_position_G, pairs.truth.v_G
    return _Whole(
        stamp_ns=error.stamp_ns,
        components=_components(error),
        speed=np.hypot(v_G[:, 0], v_G[:, 1]),
        age=age_of_information(error.stamp_ns, verdicts),
        position=by_rows(whitened, dr_G, P_G),
        horizontal=by_rows(whitened, dr_G[:, :2], P_G[:, :2, :2]),
        velocity=by_rows(whitened, error.dv_G, error.P_velocity_G),
        heading=by_rows(whitened, error.grid_heading[:, None], error.P_attitude_G[:, 2:, 2:]),
        verdicts=verdicts,
        local_ns=estimate.stamp_ns,
        local=estimate.local_statistics,
    )


def _components(error: ErrorSeries) -> dict[str, _Component]:
    none = np.full(len(error.stamp_ns), np.nan)
    found: dict[str, _Component] = {}
    for name, unit, factor, values, sigma in (
        ('phi', 'arcmin', ARCMIN, error.phi_G, error.sigma_attitude_G),
        ('v', 'm/s', 1.0, error.dv_G, error.sigma_velocity_G),
        ('r', 'm', 1.0, error.dr_G, error.sigma_position_G),
    ):
        for i, axis in enumerate('xyz'):
            found[f'{name}_{axis}'] = _Component(unit, factor, values[:, i], sigma[:, i])
    found['along'] = _Component('m', 1.0, error.along, none)
    found['cross'] = _Component('m', 1.0, error.cross, none)
    found['horizontal'] = _Component('m', 1.0, error.horizontal, none)
    found['grid_heading'] = found['phi_z']._replace(values=error.grid_heading)
    found['true_heading'] = _Component('deg', DEGREE, error.true_heading, error.true_heading_sigma)
    return found


def _window_score(window: Window, whole: _Whole) -> WindowScore:
    inside = window.rows(whole.stamp_ns)
    received = whole.verdicts.rows(window.mask(whole.verdicts.receive_ns))
    local = whole.local[window.rows(whole.local_ns)]
    components = {k: _component_score(c, inside) for k, c in whole.components.items()}
    gated = np.zeros(len(LOCAL_DOF))
    for part in parts(len(local)):
        gated += local[part, :, LOCAL_GATED].sum(axis=0)
    delay = delays(received, window)
    give_back()
    speed = whole.speed[inside]
    return WindowScore(
        window=window,
        components=components,
        nees_position=consistency_along(whole.position[inside]),
        nees_horizontal=consistency_along(whole.horizontal[inside]),
        nees_velocity=consistency_along(whole.velocity[inside]),
        nees_heading=consistency_along(whole.heading[inside]),
        nis=nis_by_source(received),
        nis_fused=nis_by_source(received, (FUSED,)),
        nis_local=nis_of_local(local),
        gated_local=dict(zip(LOCAL_DOF, map(int, gated), strict=True)),
        delay=delay,
        age=statistics(whole.age[inside]),
        lag=Lag(
            fixes=delay.count,
            mean_delay=delay.mean,
            mean_speed=float(speed.mean()) if len(speed) else float('nan'),
            found=components['horizontal'].error.rms,
            along_mean=components['along'].error.mean,
        ),
    )


def _component_score(component: _Component, inside: slice) -> ComponentScore:
    values, sigma, factor = component.values[inside], component.sigma[inside], component.factor
    both = np.isfinite(values) & np.isfinite(sigma) & (sigma > 0.0)
    ratio = values[both] / sigma[both]
    known = ratio.size > 0
    nan = float('nan')
    return ComponentScore(
        unit=component.unit,
        error=statistics(values).scaled(factor),
        sigma_rms=float(np.sqrt(np.mean(sigma[both] ** 2))) * factor if known else nan,
        normalized_rms=float(np.sqrt(np.mean(ratio**2))) if known else nan,
        within_3_sigma=float(np.mean(np.abs(ratio) <= 3.0)) if known else nan,
    )
