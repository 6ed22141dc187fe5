"""Delay handlings and noise adaptations by name, and the named configurations of both modes."""

from __future__ import annotations

from dataclasses import dataclass

DELAY_HANDLING = ('ignore', 'tagged', 'back_propagate', 'clone', 'rewind')
NOISE_ADAPTATION = (
    'none',
    'adaptive_r',
    'sage_husa',
    'sage_husa_unguarded',
    'sage_husa_published',
)
COMPILED_NOISE = ('none', 'adaptive_r')
"""Noise adaptations that are compiled, and that the vehicle's model goes along with."""
NOISE_OF = {
    'clone': ('none', 'adaptive_r'),
    'rewind': ('none', 'adaptive_r'),
    'tagged': ('none', 'adaptive_r', 'sage_husa'),
}
"""Noise adaptations that a delay handling can be joined with; all with those not named here.

`clone` and `rewind` filter the past again, in compiled code whose added variances are a diagonal;
the printed filters exist only as conventional (`ignore`) and modified (`back_propagate`).
"""


@dataclass(frozen=True)
class Configuration:
    """Delay handling, noise adaptation, gate and robust weights under one name."""

    delay_handling: str
    noise_adaptation: str
    gate_probability: float
    doc: str
    robust_fixes: str = 'none'


CONFIGURATIONS: dict[str, Configuration] = {
    'conventional_akf': Configuration(
        'ignore', 'adaptive_r', 1.0, 'takes late fixes as current; no gate, as published'
    ),
    'modified_akf': Configuration(
        'back_propagate',
        'adaptive_r',
        1.0,
        'delay-aware: H Phi^-1 at the time of validity; no gate, as published',
    ),
    'conventional_akf_published': Configuration(
        'ignore', 'sage_husa_unguarded', 1.0, 'equations (29)-(38); expected to diverge'
    ),
    'modified_akf_published': Configuration(
        'back_propagate', 'sage_husa_published', 1.0, 'equations (56)-(65); expected to diverge'
    ),
    'default': Configuration(
        'clone',
        'none',
        0.9999,
        'exact delay, stated noise, chi-square gate, robust weight',
        'mahalanobis',
    ),
}
"""Named configurations; `default` uses `rewind` with a vehicle's model."""

STATION_CONFIGURATIONS: dict[str, Configuration] = {
    'augmented': Configuration(
        'rewind', 'none', 0.9999, 'exact delay, robust weight besides the gate', 'mahalanobis'
    ),
    'published': Configuration('tagged', 'none', 1.0, 'Eqs. (8)-(13); no gate, as published'),
}
"""Configuration `default` of station mode, by its filter."""
STATION_DELAYS = {'augmented': DELAY_HANDLING, 'published': ('ignore', 'tagged')}
"""Delay handlings by the filter of station mode; the printed one has a gain of the present."""
