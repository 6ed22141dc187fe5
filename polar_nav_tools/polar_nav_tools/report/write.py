"""From `ReportInput` to one self-contained HTML file: pictures, then tables, then origins."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from polar_nav_core.user_files import writing

from ..scoring import Column, Comparison, Table
from .figures import (
    Clock,
    Picture,
    close_up,
    current_arrow,
    fix_delays,
    fix_story,
    honesty,
    horizontal_error,
    model_parameters,
    polar_map,
    position_error,
    tilt_error,
    velocity_heading_error,
)
from .input import Digest, ReportInput, TopicCount
from .story import cards, headline, warnings
from .style import MONO, SANS, TOKENS


@dataclass(frozen=True)
class Section:
    """A heading with the pictures under it."""

    key: str
    title: str
    lead: str
    groups: tuple[tuple[Picture, ...], ...]  # a group of several stands side by side
    folded: tuple[tuple[Picture, ...], ...] = ()


def write_report(path: str | os.PathLike[str], data: ReportInput) -> Path:
    """Write the report and give back its path.

    The file appears whole or not at all: it is written beside its place and then moved there.

    Raises
    ------
    ScoringError
        When a run cannot be compared with its truth.
    """
    path = Path(path)
    text = render(data)
    draft = path.with_name(f'.{path.name}.{os.getpid()}.part')
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with writing(draft):
            draft.write_text(text, encoding='utf-8')
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path


def render(data: ReportInput) -> str:
    """The HTML text. The same input gives the same text."""
    scores = data.scored()
    environment = Environment(
        loader=PackageLoader('polar_nav_tools.report', 'templates'),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters['heading'] = _heading
    style = environment.get_template('report.css.j2').render(
        tokens=TOKENS, sans=Markup(SANS), mono=Markup(MONO)
    )
    return environment.get_template('report.html.j2').render(
        data=data,
        style=Markup(style),
        script=Markup(environment.get_template('report.js').render()),
        headline=headline(scores, data.judged),
        cards=cards(scores, data.balances, data.digests, data.counts),
        warnings=warnings(scores, data.balances, data.digests, data.counts),
        sections=sections(data, scores),
        main_tables=scores.main_tables(),
        more_tables=scores.more_tables(),
        counts=_count_table(data.counts),
        balances=data.balances,
        digests=_digest_table(data.digests),
        metadata={name: _flat(section) for name, section in data.metadata.items()},
        svg=Markup,
    )


def sections(data: ReportInput, scores: Comparison) -> tuple[Section, ...]:
    """All pictures in their order."""
    truth = next(iter(data.runs.values()))[0]
    clock = Clock(int(truth.stamp_ns.min()), int(truth.stamp_ns.max()))
    runs = list(enumerate(scores.scores.values()))
    # Fixes of the last run that had them late: a smoother has each at its validity.
    shown = list(data.runs.items())
    late = [r for r in shown if any(receipt.age_s > 0.0 for receipt in r[1][2])]
    reference, (_, _, receipts) = (late or shown)[-1]
    return (
        Section(
            'where',
            'Where it went',
            '',
            ((polar_map(data, scores),), (close_up(data, scores),)),
        ),
        Section(
            'error',
            'How far off',
            '',
            (
                (horizontal_error(scores, clock),),
                tuple(position_error(s, i, clock) for i, s in runs),
                tuple(velocity_heading_error(s, i, clock) for i, s in runs),
            ),
            folded=(tuple(tilt_error(s, i, clock) for i, s in runs),),
        ),
        *_water(data, scores, clock),
        Section(
            'fixes',
            'What became of each fix',
            '',
            (
                (fix_delays(data, reference, receipts, clock),),
                tuple(fix_story(s, i, data.runs[s.name][2], clock) for i, s in runs),
            ),
        ),
        Section(
            'honesty',
            'Is the covariance honest',
            '',
            (tuple(honesty(s, i, *data.runs[s.name][1:], clock) for i, s in runs),),
        ),
    )


def _water(data: ReportInput, scores: Comparison, clock: Clock) -> tuple[Section, ...]:
    """Estimates of water and vehicle of the runs with a model of the vehicle."""
    if not scores.models:
        return ()
    places = {name: i for i, name in enumerate(scores.scores)}
    found = [(n, places[n], m, data.runs[n][0], clock) for n, m in scores.models.items()]
    return (
        Section(
            'water',
            'Water and drag',
            '',
            (
                tuple(current_arrow(*one) for one in found),
                tuple(model_parameters(*one) for one in found),
            ),
        ),
    )


def _count_table(counts: Sequence[TopicCount]) -> Table | None:
    if not counts:
        return None
    columns = (
        Column('topic', 'topic'),
        Column('published', 'published'),
        Column('recorded', 'recorded'),
        Column('received', 'received'),
        Column('equal', 'equal'),
    )
    rows = tuple(
        {
            'topic': c.topic,
            'published': c.published,
            'recorded': c.recorded,
            'received': c.received,
            'equal': c.equal,
        }
        for c in counts
    )
    return Table('Messages on their way', columns, rows)


def _digest_table(digests: Sequence[Digest]) -> Table | None:
    if not digests:
        return None
    columns = (
        Column('what', 'output'),
        Column('live', 'sha256, live run'),
        Column('replay', 'sha256, replay'),
        Column('equal', 'equal'),
    )
    rows = tuple(
        {'what': d.what, 'live': d.live, 'replay': d.replay, 'equal': d.equal} for d in digests
    )
    return Table('Live run and replay', columns, rows)


def _flat(section: Mapping[str, object], prefix: str = '') -> list[tuple[str, str]]:
    """Nested names joined with dots, values as text."""
    rows: list[tuple[str, str]] = []
    for name, value in section.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f'{prefix}{name}.')
        elif isinstance(value, (list, tuple)):
            rows.append((f'{prefix}{name}', ', '.join(str(v) for v in value)))
        else:
            rows.append((f'{prefix}{name}', str(value)))
    return rows


def _heading(column: Column) -> Markup:
    """Column title with real subscripts for axes, e.g. 'r x' and 'φx'."""
    title = re.sub(r'^(φ|v|r) ?([xyz])$', r'\1<sub>\2</sub>', str(escape(column.title)))
    unit = f' <span class="unit">{escape(column.unit)}</span>' if column.unit else ''
    return Markup(title + unit)
