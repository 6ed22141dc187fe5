"""False alarms: WARN and ERROR of the watchdog over hours in which nothing is wrong.

Every mission of the simulation, once with sensors without any common error and once with each
constant, slow and common error drawn from the sigmas that the default states (drawn.py).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from polar_nav_ros.adapters.noise_classes import dvl_noise, imu_noise
from polar_nav_sim.offline_station import StationScenario

from ...scoring.tables import Column, Table
from ..experiment import Experiment
from ..jobs import RunResult
from ..mismatch.plan import as_stated
from ..mismatch.row import FIX
from ..mismatch.scenes import SinsScene, StationScene
from ..request import Size
from .case import Case
from .drawn import Drawn, world_of
from .plan import experiment_of, of
from .runs import EvidenceResult

MISSIONS = (
    '', 'demo', 'near_pole', 'over_pole', 'south_pole', 'antimeridian', 'meridian_180',
    'racetrack', 'lawnmower', 'dive', 'model_aided',
)  # fmt: skip
"""Missions of a follower; the first is the straight run of the mismatch rows."""
HOURS_PER_WARN = 20.0
_DRAWN = '_drawn'
_DEFAULT = {'configuration': 'default', **as_stated('sins')}


def cases(duration_s: float) -> list[Case]:
    """Return all missions, plain and drawn, the shelf with its instruments, and the station."""
    out = []
    for name in MISSIONS:
        scene = SinsScene(world_of(duration_s, mission=name), FIX)
        columns = {'default': _DEFAULT}
        out.append(Case(name or 'straight', scene, columns))
        out.append(Case(f'{name or "straight"}{_DRAWN}', scene, columns, shape=Drawn()))
    shelf = world_of(
        duration_s,
        mission='shelf',
        imu='stim300',
        gyro_bias_dph=1e-3,
        accel_bias_g=1e-12,
        initial_sigma_tilt_deg=0.1,
        initial_sigma_heading_deg=1.0,
    )
    stated = {**_DEFAULT, **imu_noise('stim300'), **dvl_noise('workhorse_300')}
    out.append(Case('shelf_stim300', SinsScene(shelf, FIX), {'default': stated}))
    station = StationScene(StationScenario(duration_s=duration_s))
    out.append(Case('station', station, {'default': {'configuration': 'default'}}))
    return out


def tables(chosen: Sequence[Case], results: Sequence[RunResult], size: Size) -> list[Table]:
    """Return the table of onsets per mission, and that of the reports."""
    del size
    rows: list[dict[str, object]] = []
    for case in chosen:
        runs = of(results, case, 'default')
        rows.append({'case': case.name, **_counts(runs)})
    for title, drawn in (('all without common errors', False), ('all drawn', True)):
        runs = [r for r in results if r.group.endswith(_DRAWN) == drawn]
        if runs:
            rows.append({'case': title, **_counts(runs)})
    columns = (
        Column('case', 'mission'),
        Column('hours', 'time', 'h'),
        Column('warnings', 'rises to WARN or above'),
        Column('errors', 'rises to ERROR'),
        Column('stopped', 'stopped'),
    )
    note = f'Goal: no ERROR, at most one WARN in {HOURS_PER_WARN:g} h.'
    out = [Table('False alarms', columns, tuple(rows), note)]
    alarms = [a for r in results if isinstance(r, EvidenceResult) for a in _alarms(r)]
    if alarms:
        words = (
            Column('case', 'mission'),
            Column('level', 'level'),
            Column('culprit', 'culprit'),
            Column('count', 'rises'),
            Column('first', 'first: seed, time'),
            Column('sentence', 'sentence of the first'),
        )
        count = Counter(a[:3] for a in alarms)
        firsts = {a[:3]: a[3:] for a in reversed(alarms)}
        said = [
            dict(zip((c.key for c in words), (*key, n, *firsts[key]), strict=True))
            for key, n in count.items()
        ]
        out.append(Table('Reports', words, tuple(said)))
    return out


def _counts(runs: Sequence[RunResult]) -> dict[str, object]:
    return {
        'hours': sum(r.metrics['hours'] for r in runs),
        'warnings': int(sum(r.metrics['warnings'] for r in runs)),
        'errors': int(sum(r.metrics['errors'] for r in runs)),
        'stopped': sum(r.stopped for r in runs),
    }


def _alarms(r: EvidenceResult) -> list[tuple[str, str, str, str, str]]:
    return [
        (
            r.group,
            ('OK', 'WARN', 'ERROR')[a.level],
            a.culprit,
            f'{r.seed}, {a.stamp_ns * 1e-9:.0f} s',
            a.sentence,
        )
        for a in r.alarms
    ]


QUIET: Experiment = experiment_of(
    'quiet',
    'False alarms of the watchdog over fault-free hours of all missions',
    (Size(1800.0, 20), Size(300.0, 1)),
    cases,
    tables,
    apart=True,
)
