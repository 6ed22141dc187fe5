"""All experiments by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from polar_nav_core.errors import ConfigError

from . import ablation, consistency, tables
from .calibrate.experiment import CALIBRATE
from .cheap.experiment import BLUEROV2
from .combined_imu.experiment import COMBINED_IMU
from .evidence.aiding import AIDING
from .evidence.late import LATE
from .evidence.mems import MEMS
from .evidence.price import PRICE
from .evidence.quiet import QUIET
from .experiment import Experiment
from .hold.plan import FAULTS
from .leader_error.experiment import LEADER_ERROR
from .mismatch.plan import MISMATCH
from .request import Request, Size
from .smooth import SMOOTH
from .smooth_mismatch import SMOOTH_MISMATCH
from .spoof import SPOOF
from .station import catalog as station
from .tune.experiment import TUNE

_HOUR = 3600.0


def _pair_table(
    number: int,
    doc: str,
    plan: Callable[[Request, Size, Sequence[str]], Sequence[Any]],
    figure: str,
) -> Experiment:
    """Return the experiment of table 2 or 3: half a day, all filters, a figure of the pair."""
    name = f'table{number}'
    return Experiment(
        name,
        doc,
        Size(12 * _HOUR, 3),
        Size(60.0, 1),
        tables.COMPARED,
        plan,
        tables.tables_of(name, f'Table {number}'),
        tables.pair_figure(figure),
        tables.paper_of(name),
    )


_TABLES = (
    Experiment(
        'table1',
        'The conventional AKF under four ranges of random delay: table 1 and figure 8',
        Size(_HOUR, 5),
        Size(60.0, 1),
        tables.COMPARED,
        tables.plan_table1,
        tables.tables_table1,
        tables.figure8,
        tables.paper_table1,
    ),
    _pair_table(
        2,
        'Algorithm 1 (knows the delay) against 2 (ignores it): table 2 and figure 9',
        tables.plan_table2,
        'figure9',
    ),
    _pair_table(
        3,
        'As table2 with the noise of a real IMU: table 3 and figure 11; own IMU: imu-errors BAG',
        tables.plan_table3,
        'figure11',
    ),
)


def _picture(name: str, of: Experiment, columns: tuple[str, ...], doc: str) -> Experiment:
    """Experiment of the runs in one figure."""
    return replace(
        of,
        name=name,
        doc=doc,
        full=Size(of.full.duration_s, 1),
        quick=Size(of.quick.duration_s, 1),
        columns=columns,
    )


EXPERIMENTS: dict[str, Experiment] = {
    e.name: e
    for e in (
        *_TABLES,
        _picture(
            'figure8',
            _TABLES[0],
            ('conventional_akf',),
            'Figure 8: seed 1 of table1, one filter',
        ),
        _picture('figure9', _TABLES[1], tables.PAIR, 'Figure 9: seed 1 of table2, the pair'),
        _picture('figure11', _TABLES[2], tables.PAIR, 'Figure 11: seed 1 of table3, the pair'),
        Experiment(
            'ablation',
            'Delay strategies over delays, fix periods and process noise: error, NEES, time',
            Size(1800.0, 5),
            Size(60.0, 1),
            ablation.COLUMNS,
            ablation.plan,
            ablation.tables,
            ablation.figures,
        ),
        Experiment(
            'consistency',
            'Errors of many runs that start anywhere in the prior, against the covariance: NEES',
            Size(_HOUR, 100),
            Size(120.0, 3),
            consistency.COLUMNS,
            consistency.plan,
            consistency.tables,
            consistency.figures,
        ),
        MISMATCH,
        FAULTS,
        LEADER_ERROR,
        SPOOF,
        CALIBRATE,
        TUNE,
        SMOOTH,
        SMOOTH_MISMATCH,
        COMBINED_IMU,
        LATE,
        PRICE,
        MEMS,
        QUIET,
        AIDING,
        BLUEROV2,
        *station.EXPERIMENTS,
    )
}


def experiment_named(name: str) -> Experiment:
    """Experiment of a name.

    Raises
    ------
    ConfigError
        For an unknown name.
    """
    if name not in EXPERIMENTS:
        raise ConfigError(f'no experiment {name!r}; there are {", ".join(EXPERIMENTS)}')
    return EXPERIMENTS[name]
