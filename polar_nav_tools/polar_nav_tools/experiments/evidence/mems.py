"""A low-cost vehicle: a MEMS IMU at 10 Hz, a small DVL, a small USBL, and the vices of real ones.

Its classes are stated as `polar map` writes them (`adapters.noise_classes`): BMI088, DVL A50.
Each vice stands alone and all together; those of `BEYOND` are outside of what the classes state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from polar_nav_ros.adapters.noise_classes import dvl_noise, imu_noise
from polar_nav_sim.sensors.compass import CompassErrors
from polar_nav_sim.sensors.imu import DPH, MICRO_G
from polar_nav_sim.sensors.instruments import DVL

from ...scoring.tables import Column, Table
from .. import compass
from ..experiment import Experiment
from ..jobs import RunResult
from ..mismatch import worlds
from ..mismatch.dvl_faults import DvlBadPings
from ..mismatch.plan import as_stated
from ..mismatch.scenes import SinsScene
from ..request import Size
from ..schedule import FixSpec
from ..world import World
from ..world_spec import WorldSpec
from .case import Case
from .plan import experiment_of, of
from .pooled import values

SILENT_GOAL, ERROR_GOAL = 0.05, 0.1
"""Share of time beyond 3 sigma without ERROR; share of the seeds with ERROR."""
HOUSING_DEG = (180.0, 0.0, -45.0)
"""Roll, pitch, yaw of the DVL's housing frame: upside down, and turned against the bow."""
RESTED_DPH = 72.0
"""Sigma of what is left of the gyro bias after a minute at rest, 0.02 deg/s: ours."""
AHRS_BIAS_DEG, HARD_IRON_NT, SOFT_IRON = 3.0, 300.0, 0.01
"""Of a consumer AHRS after its calibration: bias, and what is left of the iron: ours."""
VIBRATION = 2000.0 * MICRO_G
"""White noise that vibration of a thruster folds into 10 Hz [m/s^2/sqrt(Hz)]: ours."""
_FIX = FixSpec(
    period_s=5.0, first_s=5.0, sigma=2.0, sigma_vertical=1.0, delay_kind='uniform',
    delay_least_s=1.0, delay_s=4.0, loss=0.2,
)  # fmt: skip


@dataclass(frozen=True)
class Vices:
    """What is done to a world's streams.

    Attributes
    ----------
    rested : bool
        Whether the gyro bias is what is left after a rest; otherwise the instrument's, which the
        world has.
    vibration : float
        Further white noise of the accelerometers [m/s^2/sqrt(Hz)].
    housing : bool
        Pings in the frame of the housing, which is stated.
    bad_pings : float
        Share of pings off by 1 m/s on each axis.
    stuck_s : float
        Time for which the barometer repeats a value, once in 200 s.
    ahrs : str
        What the headings of an AHRS count from; empty without one.
    """

    rested: bool = True
    vibration: float = 0.0
    housing: bool = False
    bad_pings: float = 0.0
    stuck_s: float = 0.0
    ahrs: str = ''

    def __call__(self, world: World) -> World:
        """World with the vices."""
        rng = worlds.drawn(world, 'mems')
        n = len(world.inputs.imu_stamps_ns)
        gyro = RESTED_DPH if self.rested else 0.0  # the instrument's own otherwise
        white = self.vibration * np.sqrt(world.spec.imu_rate_hz) * rng.standard_normal((n, 3))
        world = worlds.add_imu(world, gyro * DPH * rng.standard_normal(3), white)
        e = DVL['a50_standard'].errors
        scale = e.scale_sigma * rng.standard_normal()
        pitch, yaw = np.deg2rad(e.misalignment_sigma_deg) * rng.standard_normal(2)
        v_m = world.inputs.dvl_v_m
        turned = (1.0 + scale) * v_m + np.cross(np.array([0.0, pitch, yaw]), v_m)
        world = worlds.add_dvl(world, turned - v_m)
        if self.bad_pings:
            world = DvlBadPings(share=self.bad_pings, sigma=1.0).applied(world, 1.0)
        if self.housing:
            world = _in_housing(world)
        if self.ahrs:
            errors = CompassErrors(hard_iron_nt=HARD_IRON_NT, soft_iron=SOFT_IRON)
            world = compass.with_headings(world, self.ahrs, errors, AHRS_BIAS_DEG)
        return _stuck(world, self.stuck_s) if self.stuck_s else world


def _in_housing(world: World) -> World:
    roll_deg, pitch_deg, yaw_deg = HOUSING_DEG
    C_m_b = Rotation.from_euler('ZYX', [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    return worlds.add_dvl(world, world.inputs.dvl_v_m @ (C_m_b - np.eye(3)))


def _stuck(world: World, length_s: float) -> World:
    i = world.inputs
    t = worlds.seconds(world, i.depth_stamps_ns)
    rows = np.arange(len(t))
    free = (t % 200.0) >= length_s
    free[0] = True
    last = np.maximum.accumulate(np.where(free, rows, 0))
    return replace(world, inputs=replace(i, depth=i.depth[last]))


_SAIL = Vices()
_ALL = Vices(vibration=VIBRATION, housing=True, bad_pings=0.05, stuck_s=30.0)
_UNKNOWN_DEG = 180.0 / np.sqrt(3.0)
WITHIN: dict[str, tuple[Vices, dict[str, Any]]] = {
    'noise': (_SAIL, {'imu_vices': False}),
    'imu': (_SAIL, {}),
    'vibration': (replace(_SAIL, vibration=VIBRATION), {}),
    'housing': (replace(_SAIL, housing=True), {}),
    'bad_pings': (replace(_SAIL, bad_pings=0.05), {}),
    'stuck_depth': (replace(_SAIL, stuck_s=30.0), {}),
    'heading_30deg': (_SAIL, {'initial_sigma_heading_deg': 30.0}),
    'all': (_ALL, {'initial_sigma_heading_deg': 10.0}),
}
"""Vices, and fields of the world, that the stated classes contain."""
BEYOND: dict[str, tuple[Vices, dict[str, Any]]] = {
    'heading_unknown': (_SAIL, {'initial_sigma_heading_deg': float(_UNKNOWN_DEG)}),
    'not_rested': (replace(_SAIL, rested=False), {}),
    'all_unknown': (replace(_ALL, rested=False), {'initial_sigma_heading_deg': 100.0}),
    'ahrs_unknown': (
        replace(_SAIL, ahrs='true'),
        {'initial_sigma_heading_deg': float(_UNKNOWN_DEG)},
    ),
    'ahrs_not_rested': (
        replace(_SAIL, rested=False, ahrs='true'),
        {'initial_sigma_heading_deg': float(_UNKNOWN_DEG)},
    ),
    'ahrs_magnetic': (
        replace(_SAIL, ahrs='magnetic'),
        {'initial_sigma_heading_deg': float(_UNKNOWN_DEG), 'mission': 'south_pole'},
    ),
}
"""Those that a linear filter cannot be expected to cope with."""


def cases(duration_s: float) -> list[Case]:
    """Return each vice alone, and all together."""
    return [_case(name, duration_s, *rest) for name, rest in {**WITHIN, **BEYOND}.items()]


def _case(name: str, duration_s: float, vices: Vices, changes: dict[str, Any]) -> Case:
    spec: dict[str, Any] = {
        'duration_s': duration_s,
        'mission': 'lawnmower',
        'imu': 'bmi088',
        'imu_rate_hz': 10.0,
        'imu_rested': vices.rested,
        'constants': 'prior',
        # Constants beside those of the instruments, as good as none.
        'gyro_bias_dph': 1e-3,
        'accel_bias_g': 1e-12,
        'dvl_scale': 1e-9,
        'dvl_rate_hz': 5.0,
        'dvl_markov_sigma': DVL['a50_standard'].errors.markov_sigma,
        'depth_rate_hz': 5.0,
        'initial_sigma_position': 5.0,
        'initial_sigma_velocity': 0.1,
        'initial_sigma_tilt_deg': 1.5,
        'initial_sigma_heading_deg': 5.0,
    }
    scene = SinsScene(WorldSpec(**{**spec, **changes}), _FIX)
    return Case(name, scene, {'default': stated(vices)}, shape=vices)


def stated(vices: Vices) -> dict[str, Any]:
    """Return what a user states: the classes, a rest before the start, vibration, the mounting."""
    imu = imu_noise('bmi088')
    if vices.rested:
        imu['gyro_bias_sigma'] = RESTED_DPH * DPH
    imu['accel_noise_density'] = float(np.hypot(imu['accel_noise_density'], vices.vibration))
    mounting = {'dvl_rpy_deg': HOUSING_DEG} if vices.housing else {}
    return {
        'configuration': 'default',
        **as_stated('sins'),
        **imu,
        **dvl_noise('a50_standard'),
        **mounting,
        **(compass.stated(vices.ahrs, AHRS_BIAS_DEG, heading_tilts=True) if vices.ahrs else {}),
    }


def tables(chosen: Sequence[Case], results: Sequence[RunResult], size: Size) -> list[Table]:
    """Return the table of vices."""
    del size
    columns = (
        Column('case', 'vice'),
        Column('within', 'within the stated class'),
        Column('rms', 'RMS, median of seeds', 'm'),
        Column('rms_worst', 'worst seed', 'm'),
        Column('said', 'said, median', 'm'),
        Column('silent', 'time beyond 3 sigma without ERROR', '%'),
        Column('silent_worst', 'worst seed', '%'),
        Column('errors', 'seeds with ERROR'),
        Column('stopped', 'stopped'),
        Column('dvl', 'pings refused', '%'),
        Column('fix', 'fixes refused', '%'),
        Column('depth', 'depths refused', '%'),
        Column('met', 'met'),
    )
    rows = [_row(case, of(results, case, 'default')) for case in chosen]
    note = (
        f'Goal: at most {100 * SILENT_GOAL:g} % of the time beyond 3 published sigmas (position,'
        f' heading or velocity) without ERROR; ERROR in at most {100 * ERROR_GOAL:g} % of the'
        ' seeds where the vice is within the class. BMI088 at 10 Hz, DVL A50, fixes of 2 m every'
        ' 5 s, lawnmower at its speed.'
    )
    return [Table('A MEMS vehicle and its vices', columns, tuple(rows), note)]


def _row(case: Case, runs: Sequence[RunResult]) -> dict[str, object]:
    silent = values(runs, 'silent')
    errors = int(np.count_nonzero(values(runs, 'errors')))
    within = case.name in WITHIN
    met = float(silent.mean()) <= SILENT_GOAL
    met = met and (not within or errors <= ERROR_GOAL * len(runs))
    refused = {
        name: 100.0 * float(found.mean())
        for name in ('dvl', 'fix', 'depth')
        if len(found := values(runs, f'refused_{name}'))
    }
    return {
        'case': case.name,
        'within': within,
        'rms': float(np.median(values(runs, 'rms'))),
        'rms_worst': float(values(runs, 'rms').max()),
        'said': float(np.median(values(runs, 'said'))),
        'silent': 100.0 * float(silent.mean()),
        'silent_worst': 100.0 * float(silent.max()),
        'errors': f'{errors} of {len(runs)}',
        'stopped': sum(r.stopped for r in runs),
        **refused,
        'met': met,
    }


MEMS: Experiment = experiment_of(
    'mems',
    'A low-cost vehicle with the vices of real ones: beyond 3 sigma without ERROR',
    (Size(1200.0, 20), Size(200.0, 1)),
    cases,
    tables,
)
