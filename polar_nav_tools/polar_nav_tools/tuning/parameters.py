"""Noise that can be found from innovations: its parameter, what scales it, what would show it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import NO_RESERVE, EngineParams
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.params import default_of

from .level import larger

Scaled = Callable[[EngineParams, Inputs, float], tuple[EngineParams, Inputs]]

PRIOR = math.log(3.0)
"""1-sigma of the logarithm before the data: within a class instruments differ by so much."""
_LONGER = 'a longer recording'
_SHOW = {
    'gyro_noise_density': 'minutes under way with a DVL; a DVL less noisy than the IMU',
    'gyro_bias_walk': f'{_LONGER}: a bias that wanders less than the noise hides does no harm',
    'gyro_bias_sigma': 'several recordings: one start of three axes is one draw',
    'accel_noise_density': 'minutes under way with a DVL',
    'accel_bias_walk': f'{_LONGER}: a bias that wanders less than the noise hides does no harm',
    'accel_bias_sigma': 'several recordings: one start of three axes is one draw',
    'dvl_sigma': 'more pings with bottom lock',
    'dvl_markov_sigma': f'{_LONGER} with position fixes: several times its correlation time',
    'dvl_scale_sigma': 'several recordings: one scale of three axes is one draw',
    'depth_sigma': 'more depths',
    'fix_sigma': 'more position fixes',
    'fix_slow_sigma': f'{_LONGER}: several times the correlation time of the slow error',
    'heading_sigma_deg': 'headings more often than they are alike',
    'heading_markov_sigma_deg': f'{_LONGER}, on several courses',
}
DRAWN_ONCE = ('gyro_bias_sigma', 'accel_bias_sigma', 'dvl_scale_sigma')
"""Sigmas of errors that stay as they are at the start of a recording."""
_OF_THREE = 1.0 / math.sqrt(6.0)
"""1-sigma of the logarithm of a sigma of which three numbers are known exactly."""
IMU = (
    'gyro_noise_density', 'gyro_bias_walk', 'gyro_bias_sigma',
    'accel_noise_density', 'accel_bias_walk', 'accel_bias_sigma',
)  # fmt: skip
"""Parameters that the class of an IMU states."""


@dataclass(frozen=True)
class Parameter:
    """One noise of one instrument, which counts as the logarithm of its factor on what is stated.

    Attributes
    ----------
    name : str
        As of the engine's parameter, where it is one.
    unit, doc : str
    stated : float
        What it is multiplied from, in the unit.
    scaled : callable
        Parameters and inputs with so many times that noise.
    source : str
        Of fixes, where there are several.
    """

    name: str
    unit: str
    doc: str
    stated: float
    scaled: Scaled
    source: str = ''

    @property
    def label(self) -> str:
        """Name, with the source where there are several."""
        return f'{self.name} of {self.source}' if self.source else self.name

    @property
    def least_sigma(self) -> float:
        """1-sigma of the logarithm that no single recording can go below."""
        return _OF_THREE if self.name in DRAWN_ONCE else 0.0

    @property
    def show(self) -> str:
        """What would show it."""
        return _SHOW[self.name]


def reserve_of(parameter: Parameter) -> float:
    """Random walk of a bias below which none is suggested, the engine's default; else 0."""
    return float(getattr(EngineParams(), parameter.name)) if parameter.name in NO_RESERVE else 0.0


def parameters_of(params: EngineParams, inputs: Inputs) -> tuple[Parameter, ...]:
    """Noises that a run has data about.

    Raises
    ------
    ConfigError
        For a run without a measurement besides those of the IMU.
    """
    engine = [
        ('gyro_noise_density', 'rad/s/√Hz', 'white noise of the gyros'),
        ('gyro_bias_walk', 'rad/s/√s', 'random walk of the gyro bias'),
        ('gyro_bias_sigma', 'rad/s', 'gyro bias at the start'),
        ('accel_noise_density', 'm/s²/√Hz', 'white noise of the accelerometers'),
        ('accel_bias_walk', 'm/s²/√s', 'random walk of the accelerometer bias'),
        ('accel_bias_sigma', 'm/s²', 'accelerometer bias at the start'),
    ]
    sensors: list[Parameter] = []
    if inputs.dvl_valid.any():
        variance = inputs.dvl_covariance_m[inputs.dvl_valid].trace(axis1=1, axis2=2) / 3.0
        sensors.append(
            Parameter('dvl_sigma', 'm/s', 'white noise of a ping', _root(variance), _dvl)
        )
        engine += [
            ('dvl_markov_sigma', 'm/s', 'slow error of the DVL'),
            ('dvl_scale_sigma', '', 'scale of the DVL'),
        ]
    if len(inputs.depth):
        sigma = _root(inputs.depth_variance)
        sensors.append(Parameter('depth_sigma', 'm', 'white noise of a depth', sigma, _depth))
    sensors += _of_fixes(inputs)
    if params.uses_heading and len(inputs.headings):
        white, coloured = 'white noise of a heading', 'coloured error of a heading'
        sensors.append(_of_params(params, 'heading_sigma_deg', 'deg', white))
        sensors.append(_of_params(params, 'heading_markov_sigma_deg', 'deg', coloured))
    if not sensors:
        raise ConfigError('there is nothing to tune by: no DVL, no depths, no fixes, no headings')
    return (*(_of_params(params, *row) for row in engine), *sensors)


def base_of(params: EngineParams, name: str) -> float:
    """Stated number that a noise of the engine is multiplied from; its default where that is 0."""
    stated = float(getattr(params, name))
    return stated or float(default_of(EngineParams, name))


def _of_params(params: EngineParams, name: str, unit: str, doc: str) -> Parameter:
    base = base_of(params, name)
    limits = next(f.metadata for f in fields(EngineParams) if f.name == name)

    def scaled(params: EngineParams, inputs: Inputs, by: float) -> tuple[EngineParams, Inputs]:
        changes: dict[str, Any] = {name: min(max(by * base, limits['lo']), limits['hi'])}
        return replace(params, **changes), inputs

    return Parameter(name, unit, doc, base, scaled)


def _root(variances: Array) -> float:
    return math.sqrt(float(np.median(variances)))


def _dvl(params: EngineParams, inputs: Inputs, by: float) -> tuple[EngineParams, Inputs]:
    return params, replace(inputs, dvl_covariance_m=by * by * inputs.dvl_covariance_m)


def _depth(params: EngineParams, inputs: Inputs, by: float) -> tuple[EngineParams, Inputs]:
    return params, replace(inputs, depth_variance=by * by * inputs.depth_variance)


def _of_fixes(inputs: Inputs) -> list[Parameter]:
    """Noise of the fixes of each source, and of what they share with those before."""
    usable = [f for f in inputs.fixes if f.refusal is None and f.polar is None]
    sources = list(dict.fromkeys(f.source for f in usable))
    out = []
    for source in sources:
        mine = [f for f in usable if f.source == source]
        named = source if len(sources) > 1 else ''
        white = [horizontal_variance(f, own_covariance(f)) for f in mine]
        doc = 'white noise of a fix, per horizontal axis'
        out.append(
            Parameter('fix_sigma', 'm', doc, _root(np.array(white)), _fixes(source, 'own'), named)
        )
        shared = [f.leader_sigma for f in mine if f.leader_sigma > 0.0]
        if shared:
            doc = 'error that fixes share with those before (their leader)'
            scaled = _fixes(source, 'shared')
            sigma = float(np.median(shared))
            out.append(Parameter('fix_slow_sigma', 'm', doc, sigma, scaled, named))
    return out


def horizontal_variance(fix: Fix, covariance_e: Array) -> float:
    """Variance per horizontal axis of a covariance of a fix, ECEF [m^2]."""
    C_e_G = np.asarray(ecef_to_grid(fix.r_e))
    return float(np.trace((C_e_G @ covariance_e @ C_e_G.T)[:2, :2])) / 2.0


def shared_covariance(fix: Fix) -> Array:
    """Part of the covariance of a fix that it shares with others, ECEF, shape (3, 3) [m^2]."""
    if not (fix.leader_sigma > 0.0 or fix.leader_heading_sigma > 0.0):
        return np.zeros((3, 3))
    C_e_G = np.asarray(ecef_to_grid(fix.r_e - fix.relative_e))
    x, y, _ = C_e_G @ fix.relative_e
    turn = fix.leader_heading_sigma * np.array([-y, x, 0.0])
    P_G = np.diag([fix.leader_sigma**2, fix.leader_sigma**2, 0.0]) + np.outer(turn, turn)
    return np.asarray(C_e_G.T @ P_G @ C_e_G)


def own_covariance(fix: Fix) -> Array:
    """Covariance of a fix without what it shares; at least a hundredth of it stays."""
    if not (fix.leader_sigma > 0.0 or fix.leader_heading_sigma > 0.0):
        return fix.covariance_e
    own = fix.covariance_e - shared_covariance(fix)
    values, V = np.linalg.eigh(0.5 * (own + own.T))
    least = 0.01 * np.einsum('ji,jk,ki->i', V, fix.covariance_e, V)
    return np.asarray((V * np.maximum(values, least)) @ V.T)


def _fixes(source: str, part: str) -> Scaled:
    def one(fix: Fix, by: float) -> Fix:
        if fix.source != source or fix.refusal is not None or fix.polar is not None:
            return fix
        own, shared = own_covariance(fix), shared_covariance(fix)
        if part == 'own':
            return fix.believed_to(larger(fix, own, by) + shared)
        return replace(
            fix.believed_to(own + by * by * shared),
            leader_sigma=by * fix.leader_sigma,
            leader_heading_sigma=by * fix.leader_heading_sigma,
        )

    def scaled(params: EngineParams, inputs: Inputs, by: float) -> tuple[EngineParams, Inputs]:
        if by == 1.0:
            return params, inputs
        return params, replace(inputs, fixes=tuple(one(f, by) for f in inputs.fixes))

    return scaled
