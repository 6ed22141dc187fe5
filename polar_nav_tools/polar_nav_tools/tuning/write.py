"""Writes suggested noise into a copy of a mapping file, or as parameters; comments stay."""

from __future__ import annotations

import math
from pathlib import Path

from ruamel.yaml.comments import CommentedMap

from polar_nav_core.user_files import read_text
from polar_nav_ros.adapters.mapping import Mapping as Sources
from polar_nav_ros.adapters.noise_classes import NAMES as NOISE_KEYS

from ..calibration.verdicts import Verdict
from ..foreign.mapping_text import Written, load_text, parameters_of, put, sections, text_of
from .bag import Tuning
from .parameters import reserve_of
from .verdicts import Line

_HEADING = {'heading_sigma_deg': 'sigma_deg', 'heading_markov_sigma_deg': 'coloured_sigma_deg'}
_OF_A_LEADER = 'state it where the fixes are made: packets come with their own'
_AT_THE_SENSOR = 'its messages state their own noise: correct it in the driver'


def parameter_lines(found: Tuning) -> Written:
    """Lines of ``parameters:`` for a vehicle without a mapping file."""
    top = CommentedMap()
    names, left = [], {}
    for line in found.lines:
        if not line.changes:
            continue
        name = line.parameter.name
        if name.startswith('fix_'):
            left[line.parameter.label] = _OF_A_LEADER
        elif name in ('dvl_sigma', 'depth_sigma'):
            left[name] = _AT_THE_SENSOR
        else:
            put(parameters_of(top), name, line.suggested, _origin(found, line))
            names.append(name)
    return Written(text_of(top) if names else '', tuple(names), left)


def mapping_file(path: Path, found: Tuning, mapping: Sources) -> Written:
    """Text of a mapping file with suggested noise and where it is from.

    Parameters
    ----------
    path : Path
        The mapping file of this run.
    found : Tuning
    mapping : Mapping
        What that file says.
    """
    top = load_text(read_text(path))
    names, left = [], {}
    for line in found.lines:
        if not line.changes:
            continue
        why = _enter(top, found, mapping, line)
        if why:
            left[line.parameter.label] = why
        else:
            names.append(line.parameter.label)
    return Written(text_of(top), tuple(names), left)


def _enter(top: CommentedMap, found: Tuning, mapping: Sources, line: Line) -> str:
    """Enter a value into a mapping; returns why it could not be, or nothing."""
    name, origin = line.parameter.name, _origin(found, line)
    if name in ('dvl_sigma', 'depth_sigma'):
        for section in sections(top, name.removesuffix('_sigma')):
            put(section, 'sigma', line.suggested, origin)
    elif name in _HEADING and top.get('heading') is not None:
        put(top['heading'], _HEADING[name], line.suggested, origin)
    elif name.startswith('fix_'):
        return _enter_fix(top, found, mapping, line)
    else:
        section = parameters_of(top)
        if name not in section and name in NOISE_KEYS:
            if top.get('noise') is None:
                top['noise'] = CommentedMap()
            section = top['noise']  # where a number beside the class of an instrument wins
        put(section, name, line.suggested, origin)
    return ''


def _enter_fix(top: CommentedMap, found: Tuning, mapping: Sources, line: Line) -> str:
    """Enter the noise of the fixes of a source; the vertical one by the same factor."""
    factor = line.suggested / line.parameter.stated
    for section, fix in zip(sections(top, 'fixes'), mapping.fixes, strict=True):
        if line.parameter.source and fix.source != line.parameter.source:
            continue
        if line.parameter.name == 'fix_slow_sigma':
            if not fix.slow_sigma:
                return _OF_A_LEADER
            put(section, 'slow_sigma', factor * fix.slow_sigma, _origin(found, line))
            continue
        if fix.sigma is None and _made_of_packets(fix.position.stream.type, section):
            return _OF_A_LEADER
        sigma = line.suggested if fix.sigma is None else factor * fix.sigma[0]
        vertical = sigma * (_ratio(found, fix.source) if fix.sigma is None else 1.0)
        if fix.sigma is not None:
            vertical = factor * fix.sigma[1]
        level = fix.dimensions == 2 and not isinstance(section.get('sigma'), list)
        put(section, 'sigma', sigma if level else [sigma, vertical], _origin(found, line))
    return ''


def _made_of_packets(kind: str, section: CommentedMap) -> bool:
    fields = section.get('fields') or {}
    return kind.endswith(('AcousticPacket', 'UsblFix')) or 'payload' in fields


def _ratio(found: Tuning, source: str) -> float:
    """Vertical sigma of the fixes of a source as a share of the horizontal one."""
    from .parameters import horizontal_variance, own_covariance

    for fix in found.run.inputs.fixes:
        if fix.source == source and fix.refusal is None:
            P = own_covariance(fix)
            across = horizontal_variance(fix, P)
            return math.sqrt(max(float(P.trace()) - 2.0 * across, 0.0) / across)
    return 1.0


def _origin(found: Tuning, line: Line) -> str:
    how = 'at most, as the data show'
    if math.isclose(line.suggested, reserve_of(line.parameter)):
        how = 'no less: a reserve for warmth and for the gravity of other places'
    elif line.verdict is Verdict.ESTIMATED:
        how = f'1-sigma {100.0 * line.sigma_share:.2g} %'
    elif line.suggested > line.parameter.stated:
        how = 'most probable, not well known'
    return (
        f'polar tune {found.run.path.name} of {found.run.recorded:%Y-%m-%d}: stated '
        f'{line.parameter.stated:.4g}; {how}'
    )
