"""All experiments `has-*` by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

from ..experiment import Experiment, no_figures
from ..request import Size
from ..station_choices import choices_from
from ..suite import Suite
from . import cases
from .columns import COLUMNS, pick
from .runs import StationJob, run_job
from .summary import long_table

_RUN = Size(1600.0, 5)
_QUICK = Size(1600.0, 1)


def _read(settings: Sequence[str], columns: Sequence[str] | None) -> dict[str, Any]:
    pick(columns or ())
    return {'station': choices_from(settings)}


def _describe(plan: Sequence[StationJob]) -> dict[str, Any]:
    return {
        'filters': {
            job.column.name: {
                'about': job.column.doc,
                'engine': {**job.column.changes, **job.choices.engine},
                'fixes_as_of_arrival': job.column.uncompensated,
            }
            for job in plan
        },
        'groups': {
            job.group: {'scenario': asdict(job.scenario), 'later_s': job.later_s} for job in plan
        },
    }


STATION = Suite(
    _read,
    lambda names: [n for n in names if n in COLUMNS],
    run_job,
    long_table,
    lambda request: asdict(request.station),
    _describe,
)
"""Of the paper of the DVL-less system."""

_TABLE = Experiment(
    'has-table',
    "No DVL, fixes of a station: the paper's claims beside all filters, full and half noise",
    _RUN,
    _QUICK,
    cases.COMPARED,
    cases.plan_table,
    cases.tables_table,
    cases.figures_table,
    cases.paper_of,
    STATION,
)

EXPERIMENTS = (
    _TABLE,
    replace(
        _TABLE,
        name='has-figures',
        doc="The paper's figures 4 to 10: published and default filter, seed 1",
        full=_QUICK,
        columns=cases.SHOWN,
        plan=cases.plan_figures,
        tables=cases.tables_figures,
        figures=cases.figures_figures,
    ),
    replace(
        _TABLE,
        name='has-loss',
        doc='0, 10, 30 and 50 % of the packets lost',
        columns=('published', 'augmented_1e-6', 'default'),
        plan=cases.plan_loss,
        tables=cases.tables_loss,
        figures=cases.figures_loss,
        paper=None,
    ),
    replace(
        _TABLE,
        name='has-current',
        doc='A current that changes by 30 % and 0.6 rad in 30 minutes',
        columns=(
            'published',
            'published_again',
            'published_robust',
            'augmented_1e-6',
            'augmented_1e-5',
            'default',
        ),
        plan=cases.plan_current,
        tables=cases.tables_current,
        figures=cases.figures_current,
        paper=None,
    ),
    replace(
        _TABLE,
        name='has-excitation',
        doc='Thrust that hardly varies: the drag that can still be identified',
        columns=('published', 'published_robust', 'augmented_1e-6', 'default'),
        plan=cases.plan_excitation,
        tables=cases.tables_excitation,
        figures=no_figures,
        paper=None,
    ),
    replace(
        _TABLE,
        name='has-heading',
        doc='A heading that is 2 degrees off',
        columns=('published', 'published_robust', 'augmented_1e-6', 'default'),
        plan=cases.plan_heading,
        tables=cases.tables_heading,
        figures=no_figures,
        paper=None,
    ),
    replace(
        _TABLE,
        name='has-delay',
        doc='Packets 0, 2 and 8 s later, the last beyond the period; delay ignored',
        columns=(
            'published',
            'published_uncompensated',
            'published_shifted',
            'augmented_1e-6',
            'augmented_ignoring',
            'default',
        ),
        plan=cases.plan_delay,
        tables=cases.tables_delay,
        figures=cases.figures_delay,
        paper=None,
    ),
)
