"""Section `heading` of a mapping file: an AHRS or compass, and what its headings count from."""

from __future__ import annotations

from typing import Any

from polar_nav_core.engine.heading_params import REFERENCES

from .layouts import USBL
from .mapping import ANGLE_UNITS, WORLDS, FixMapping, HeadingMapping
from .packets import carries_packets
from .section import Section
from .stream_section import stream_of


def heading_of(s: Section, params: dict[str, Any]) -> HeadingMapping:
    """AHRS or compass; what its headings count from goes to the engine's parameters."""
    stream = stream_of(s)
    references = REFERENCES[1:]
    if 'reference' not in s:
        raise s.fail('reference', f'is missing: one of {", ".join(references)}')
    # The word is a truth value to YAML.
    reference = 'true' if s.raw('reference') is True else s.choice('reference', references)
    params['heading_reference'] = reference
    if reference == 'magnetic':
        params['heading_declination_deg'] = s.number(
            'declination_applied_deg', None, -180.0, 180.0, 'deg, 0 if the driver adds none'
        )
    for key, name in _SIGMAS.items():
        value = s.optional(key, 1e-3, 180.0, 'deg')
        if value is not None:
            params[name] = value
    if 'tilts' in s:
        params['heading_tilts'] = s.choice('tilts', ('used', 'unused')) == 'used'
    s.raw('tilts')
    scale = ANGLE_UNITS[s.choice('unit', tuple(ANGLE_UNITS), 'deg')]
    clockwise = s.choice('positive', ('clockwise', 'counterclockwise'), 'clockwise')
    mapping = HeadingMapping(
        stream=stream,
        C_s_b=s.rotation(),
        world=s.choice('world', WORLDS, 'enu'),
        scale=scale if clockwise == 'clockwise' else -scale,
    )
    s.done()
    return mapping


_SIGMAS = {
    'sigma_deg': 'heading_sigma_deg',
    'bias_sigma_deg': 'heading_bias_sigma_deg',
    'coloured_sigma_deg': 'heading_markov_sigma_deg',
    'tilt_sigma_deg': 'heading_tilt_sigma_deg',
}
"""Keys of a heading, each with the parameter of the engine that it states."""


def check_slow_errors(s: Section, fixes: tuple[FixMapping, ...]) -> None:
    """Refuse headings beside fixes with a slow error, which the same states estimate."""
    for fix in fixes:
        stream = fix.position.stream
        of_leader = fix.leader is not None or stream.type == USBL or carries_packets(stream)
        if of_leader or fix.slow_sigma > 0.0:
            whose = 'error of the leader' if of_leader else 'slow error of the fixes (slow_sigma)'
            raise s.fail(
                'reference',
                f'does not go with {stream.topic}: the {whose} and that of the heading are '
                'estimated in the same three states; leave out one of them',
            )
