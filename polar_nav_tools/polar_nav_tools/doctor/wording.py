"""Findings as printed by `./polar doctor`: a line of text, values for JSON."""

from __future__ import annotations

from ..bags.finding import Finding, Severity

LEVELS = {
    Severity.OK: 'ok',
    Severity.NOTE: 'note',
    Severity.WARNING: 'warning',
    Severity.SEVERE: 'error',
}


def line(finding: Finding) -> str:
    """Return the finding as one line of text."""
    where = f'{finding.topic}: ' if finding.topic else ''
    when = '' if finding.at_s is None else f', at {finding.at_s:.3f} s'
    return f'{LEVELS[finding.severity]:>7}  {where}{finding.text}{when}'


def to_dict(finding: Finding) -> dict[str, object]:
    """Return the finding as values for JSON."""
    return {
        'level': LEVELS[finding.severity],
        'what': finding.name,
        'topic': finding.topic,
        'stamp_ns': finding.stamp_ns,
        'number': finding.value,
        'text': finding.text,
        'at_s': finding.at_s,
    }
