"""Warnings: valid parameters that look like mistakes, sensors too fast, a model without thrust."""

from __future__ import annotations

from dataclasses import fields

from .driver import Driver
from .params import EngineParams
from .results import CORRECTIONS_PER_S, IMU_PERIOD_S
from .sins.filter import NavigationFilter
from .sins.fusion import Fusion

_ONLY_CUSTOM = ('delay_handling', 'noise_adaptation', 'gate_probability', 'robust_fixes')
_SMALL_ANGLE_DEG = 10.0
"""Beyond this 1-sigma the linear error model of attitude is off by percents."""


def warnings_of(params: EngineParams) -> list[str]:
    """Sentences about valid parameters that look like a mistake; empty list without any."""
    return [
        *_not_used(params),
        *_blind(params),
        *_waits_too_long(params),
        *_without_process_noise(params),
        *_large_angles(params),
    ]


def history_warning(params: EngineParams, fusion: Driver | None, start_ns: int) -> str:
    """Warning that sensors are faster than the stored history has room for; empty if not.

    Parameters
    ----------
    params : EngineParams
    fusion : Driver or None
        At work since ``start_ns``.
    start_ns : int
    """
    if fusion is None:
        return ''
    oldest_ns = fusion.oldest_ns()
    reach_s = (fusion.stamp_ns - oldest_ns) * 1e-9
    if isinstance(fusion, Fusion):
        start_ns = max(start_ns, fusion.replaced_ns)
    if oldest_ns <= start_ns or reach_s >= params.max_delay_s:
        return ''
    return (
        f'the stored history reaches back {reach_s:.1f} s, less than max_delay_s '
        f'{params.max_delay_s:.1f} s: more than {1.0 / IMU_PERIOD_S:.0f} IMU samples or '
        f'{CORRECTIONS_PER_S:.0f} corrections a second outrun its room; a longer history_s helps'
    )


def aiding_warning(f: NavigationFilter | None) -> str:
    """Warning that the vehicle's model lacks thrust or replaces the DVL; empty if not.

    Parameters
    ----------
    f : NavigationFilter or None
        With a vehicle's model.
    """
    if f is None:
        return ''
    if not f.knows_thrust:
        return 'no thrust on control/thrust: the model of the vehicle says nothing by itself'
    if not f.has_bottom_lock and f.has_water_track:
        return (
            f'no bottom lock for {f.since_bottom_lock_s:.0f} s: velocity through the water and '
            'the estimated current stand in for it'
        )
    if not f.has_bottom_lock:
        return (
            f'no bottom lock for {f.since_bottom_lock_s:.0f} s: the model of the vehicle stands '
            'in for the DVL'
        )
    return ''


def _not_used(p: EngineParams) -> list[str]:
    if p.configuration == 'custom':
        return []
    default = {f.name: f.default for f in fields(p)}
    return [
        f'parameter {name}: {getattr(p, name)} is not used, configuration is {p.configuration} '
        '(it counts when configuration is custom)'
        for name in _ONLY_CUSTOM
        if getattr(p, name) != default[name]
    ]


def _blind(p: EngineParams) -> list[str]:
    c = p.resolved()
    if c.gate_probability < 1.0 or c.robust_fixes != 'none' or c.noise_adaptation != 'none':
        return []
    return [
        'parameter gate_probability: 1.0 with noise_adaptation none and robust_fixes none takes '
        'every wrong fix at full weight, and nothing will be reported'
    ]


def _waits_too_long(p: EngineParams) -> list[str]:
    if p.reorder_window_s < p.max_delay_s:
        return []
    return [
        f'parameter reorder_window_s: {p.reorder_window_s} s is as long as max_delay_s; all '
        'estimates wait for it, while late fixes need no window'
    ]


def _without_process_noise(p: EngineParams) -> list[str]:
    pairs = (('gyro_noise_density', 'gyro_bias_walk'), ('accel_noise_density', 'accel_bias_walk'))
    return [
        f'parameters {noise} and {walk}: both 0.0, so the covariance only shrinks and new '
        'measurements count less and less'
        for noise, walk in pairs
        if getattr(p, noise) == 0.0 and getattr(p, walk) == 0.0
    ]


def _large_angles(p: EngineParams) -> list[str]:
    if p.initialize in ('service', 'alignment'):
        return []
    return [
        f'parameter {name}: {getattr(p, name)} deg is beyond the small-angle error model '
        f'({_SMALL_ANGLE_DEG:.0f} deg): align first'
        for name in ('initial_sigma_tilt_deg', 'initial_sigma_heading_deg')
        if getattr(p, name) > _SMALL_ANGLE_DEG
    ]
