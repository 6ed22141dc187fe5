"""Section `fixes` of a mapping file: sources of position fixes, and which may stand together."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from .mapping import ENCODINGS, FixMapping
from .section import TO_FILL, Section, is_to_fill
from .stream_section import position_of


def fixes_of(top: Section, params: dict[str, Any], *, level: bool) -> tuple[FixMapping, ...]:
    """All sources of fixes, 2-D unless stated if level; the engine knows one transponder."""
    sections = top.sections('fixes')
    antennas = [_antenna(s) for s in sections]
    fixes = tuple(_fix(s, params, level=level) for s in sections)
    others = [lever for (_, lever), a in zip(fixes, antennas, strict=True) if a is None]
    levers = [lever for lever in others if lever is not None]
    if levers and (len(set(levers)) > 1 or len(levers) < len(others)):
        raise top.fail(
            'fixes',
            'transponder_lever_b is not the same in all of them; the filter knows one point of '
            'the vehicle that fixes locate: state one, or replay with one source at a time',
        )
    if not others:  # the first antenna is the point that the filter knows
        levers = [a for a in antennas if a is not None][:1]
    if levers:
        params['transponder_lever_b'] = list(levers[0])
    x, y, z = params.get('transponder_lever_b', (0.0, 0.0, 0.0))
    found = tuple(
        fix if a is None else replace(fix, offset_b=(a[0] - x, a[1] - y, a[2] - z))
        for (fix, _), a in zip(fixes, antennas, strict=True)
    )
    _check_slow(top, found, params)
    return found


def _antenna(s: Section) -> tuple[float, float, float] | None:
    """Lever arm of an antenna of its own, where one is stated."""
    found = None
    if 'antenna_lever_b' in s:
        if 'transponder_lever_b' in s:
            raise s.fail('antenna_lever_b', 'and transponder_lever_b are both given: name one')
        found = s.numbers('antenna_lever_b', None, -100.0, 100.0, 'm')
    s.raw('antenna_lever_b')
    return found


def _check_slow(top: Section, fixes: tuple[FixMapping, ...], params: dict[str, Any]) -> None:
    """Refuse a slow error beside another one: the engine estimates one, of fixes or a leader."""
    if not any(fix.slow_sigma > 0.0 for fix in fixes):
        return
    if len(fixes) > 1:
        raise top.fail(
            'fixes',
            'slow_sigma goes with one source of fixes: the filter estimates one slow error',
        )
    if params.get('usbl_bias_sigma'):
        raise top.fail('fixes', 'slow_sigma does not go with usbl_bias_sigma: state one of them')


def _slow(s: Section, params: dict[str, Any]) -> tuple[float, float]:
    """Return the slow error of a source [m], and for how long whole errors are alike [s].

    With a slow error the correlation time is its own, and the engine's parameter.
    """
    sigma = s.optional('slow_sigma', 1e-3, 1000.0, 'm')
    tau_s = s.number('correlation_s', 0.0, 0.0, 1e6, 's')
    if sigma is None:
        return 0.0, tau_s
    if tau_s < 1.0:
        raise s.fail('slow_sigma', 'goes with correlation_s: how large, and alike for how long')
    if 'leader_error_tau' in params:
        raise s.fail('correlation_s', 'is stated among parameters, too, as leader_error_tau')
    params['leader_error_tau'] = tau_s
    return sigma, 0.0


def _fix(
    s: Section, params: dict[str, Any], *, level: bool
) -> tuple[FixMapping, tuple[float, float, float] | None]:
    """One source of fixes, and the lever arm of its transponder where one is stated."""
    lever = None
    if 'transponder_lever_b' in s:
        lever = s.numbers('transponder_lever_b', None, -100.0, 100.0, 'm')
    s.raw('transponder_lever_b')
    sigma = s.raw('sigma')
    usual = 2 if level and not isinstance(sigma, list) else 3
    dimensions = int(s.number('dimensions', usual, 2.0, 3.0, ''))
    if sigma is not None:
        pair = sigma if isinstance(sigma, list) else [sigma, sigma]
        if len(pair) != 2 or not all(isinstance(v, int | float) and v > 0.0 for v in pair):
            said = TO_FILL if is_to_fill(sigma) else f'{sigma!r} is not'
            raise s.fail('sigma', f'{said} [horizontal, vertical], or one number, above zero [m]')
        sigma = (float(pair[0]), float(pair[1]))
    delay_s = s.optional('delay_s', 0.0, 3600.0, 's')
    slow_sigma, correlation_s = _slow(s, params)
    leader, array = s.section('leader'), s.section('array')
    position = position_of(s, finished=False)
    mapping = FixMapping(
        position=position,
        source=s.text('source', position.stream.topic.strip('/')),
        delay_ns=None if delay_s is None else round(delay_s * 1e9),
        sigma=sigma,
        leader=None if leader is None else position_of(leader),
        C_a_b=np.eye(3) if array is None else array.rotation(),
        lever_b=(0.0, 0.0, 0.0)
        if array is None
        else array.numbers('lever_b', (0.0, 0.0, 0.0), -100.0, 100.0, 'm'),
        leader_id=int(s.number('leader_id', 1.0, 0.0, 255.0, '')),
        own_id=int(s.number('own_id', 2.0, 0.0, 255.0, '')),
        dimensions=dimensions,
        encoding=s.choice('encoding', ENCODINGS) if 'encoding' in s else '',
        correlation_s=correlation_s,
        delay_sigma_s=s.number('delay_sigma_s', 0.0, 0.0, 60.0, 's'),
        slow_sigma=slow_sigma,
        surface_depth=s.number('surface_depth', math.inf, 0.0, 100.0, 'm'),
    )
    s.raw('encoding')
    if array is not None:
        array.done()
    s.done()
    return mapping, lever
