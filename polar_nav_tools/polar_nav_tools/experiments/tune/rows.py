"""Rows of the experiment: noise that is stated wrong, on a vehicle whose noise is known.

In rows `wrong_*` it is stated right, and something else is not: that is not to become noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.params import EngineParams
from polar_nav_ros.adapters.noise_classes import imu_noise
from polar_nav_sim.randomness import stream

from ...tuning.likelihood import noisier
from ...tuning.parameters import parameters_of
from ..calibrate.rows import SCENES, world_of
from ..mismatch.dvl_faults import DepthGain, DvlGain, DvlMirrored, DvlPlace
from ..mismatch.faults import Fault, FixClock, FixLever, ImuTurned
from ..schedule import FixSpec
from ..world import World, make_world
from ..world_spec import WorldSpec

WRONG = 5.0
"""How many times too large or too small noise is stated."""
SCENE = SCENES[0]
_FIXES = FixSpec(period_s=2.0, first_s=2.0, delay_s=3.0)
LATE = replace(_FIXES, delay_s=8.0)
"""Validity cannot be stated after reception: fixes late by more than any delay that is off."""
WALKS = {'gyro_bias_walk': 3e-6, 'accel_bias_walk': 2e-4}
"""Of the biases of this vehicle's IMU [rad/s/rt-s, m/s^2/rt-s]."""


@dataclass(frozen=True)
class Row:
    """What is stated wrong.

    Attributes
    ----------
    name : str
    factors : mapping of str to float
        What each noise is multiplied by, by its name.
    imu_class : str
        Class of the IMU that the file states, in place of the right one.
    fault : Fault, optional
        What else than noise is wrong.
    """

    name: str
    factors: Mapping[str, float]
    imu_class: str = ''
    fault: Fault | None = None

    def stated(
        self, duration_s: float, seed: int
    ) -> tuple[EngineParams, Inputs, Mapping[str, float]]:
        """Parameters and inputs as stated, and the true noises by name."""
        if self.imu_class:
            world = mems_world(duration_s, seed)
            params = world.params(configuration='default', **imu_noise(self.imu_class))
        else:
            world = _tactical(duration_s, seed, self.fault)
            params = world.params(configuration='default', **WALKS)
        parameters = parameters_of(params, world.inputs)
        at = [math.log(self.factors.get(p.name, 1.0)) for p in parameters]
        true = {} if self.imu_class else {p.name: p.stated for p in parameters}
        return (*noisier(params, world.inputs, parameters, np.array(at)), true)


@cache
def _spec(duration_s: float) -> WorldSpec:
    """The vehicle of the experiment `calibrate`, with an IMU whose noise shows."""
    return replace(
        world_of(SCENE, duration_s, 1).spec,
        imu='stim300',
        imu_vices=False,
        dvl_scale=1e-3,
        gyro_bias_dph=5.0,
        accel_bias_g=7.5e-4,
    )


def _tactical(duration_s: float, seed: int, fault: Fault | None) -> World:
    """World of white noise and biases that walk, as the filter models them, and a fault."""
    fixes = LATE if isinstance(fault, FixClock) else _FIXES
    world = make_world(_spec(duration_s), fixes, seed)
    n = len(world.inputs.imu_stamps_ns)
    root_dt = 1.0 / math.sqrt(world.spec.imu_rate_hz)
    rng = stream(seed, 'tune/walk')
    gyro, accel = (
        size * root_dt * np.cumsum(rng.standard_normal((n, 3)), axis=0) for size in WALKS.values()
    )
    world = _with_errors(world, gyro, accel)
    return world if fault is None else fault.applied(world, 1.0)


def mems_world(duration_s: float, seed: int) -> World:
    """World of a MEMS IMU, with all that the simulation knows of its errors."""
    spec = replace(
        _spec(duration_s),
        imu='bmi088',
        imu_vices=True,
        imu_rested=True,
        initial_sigma_tilt_deg=1.0,
        initial_sigma_heading_deg=3.0,
    )
    return make_world(spec, _FIXES, seed)


def _with_errors(world: World, gyro_b: Array, accel_b: Array) -> World:
    inputs = world.inputs
    inputs = replace(inputs, omega_ib_b=inputs.omega_ib_b + gyro_b, f_b=inputs.f_b + accel_b)
    return replace(world, inputs=inputs)


TUNED = (
    'gyro_noise_density', 'gyro_bias_walk', 'accel_noise_density', 'accel_bias_walk', 'dvl_sigma',
    'dvl_markov_sigma', 'depth_sigma', 'fix_sigma',
)  # fmt: skip
"""Noises of a tactical vehicle that are stated wrong."""
_WRONG: Mapping[str, Fault] = {
    **{f'dvl_yaw_{deg}': DvlGain(turn_deg=deg) for deg in (30, 45, 90, 135, 180)},
    'dvl_mirrored': DvlMirrored(),
    'dvl_lever_2m': DvlPlace(lever_b=(2.0, 0.0, 0.0)),
    'imu_yaw_90': ImuTurned(deg=90.0, axis=(0.0, 0.0, 1.0)),
    'imu_yaw_180': ImuTurned(deg=180.0, axis=(0.0, 0.0, 1.0)),
    'depth_sign': DepthGain(scale=-2.0),
    'delay_1.6s': FixClock(offset_s=1.6),
    'delay_5s': FixClock(offset_s=5.0),
    'fix_lever_3m': FixLever(lever_b=(0.0, 3.0, 0.0)),
}
"""What else than noise is wrong."""
ROWS = (
    Row('right', {}),
    Row('low', dict.fromkeys(TUNED, 1.0 / WRONG)),
    Row('high', dict.fromkeys(TUNED, WRONG)),
    Row('mixed', {name: WRONG ** (-1) ** k for k, name in enumerate(TUNED)}),
    *(Row(f'{name}_low', {name: 1.0 / WRONG}) for name in TUNED),
    *(Row(f'{name}_high', {name: WRONG}) for name in TUNED),
    Row('mems', {}, 'stim300'),
    *(Row(f'wrong_{name}', {}, fault=fault) for name, fault in _WRONG.items()),
)
