"""Simulated worlds of the frozen matrix: inputs of a run, and the parameters that know them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polar_nav_core.engine.events import Command, CommandKind, Fix
from polar_nav_core.engine.params import (
    EngineParams,
)
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.station.world import make_world as make_station_world
from polar_nav_tools.experiments.station_choices import StationChoices
from polar_nav_tools.experiments.world import World, make_world
from polar_nav_tools.experiments.world_spec import WorldSpec

NS = 1_000_000_000


@dataclass(frozen=True)
class Simulated:
    """Inputs of a run with the parameters that know them: ``params(**changes)``."""

    inputs: Any
    params: Callable[..., EngineParams]
    commands: tuple[Command, ...] = ()


def _sins(
    duration_s: float,
    fixes: FixSpec,
    change: Callable[[World], Any] | None = None,
    always: Mapping[str, Any] | None = None,
    **spec: Any,
) -> Simulated:
    """Make a world of a follower with SINS; ``change`` gives other inputs."""
    values = {'constants': 'prior', 'dvl_rate_hz': 5.0, 'depth_rate_hz': 5.0, **spec}
    world = make_world(WorldSpec(duration_s=duration_s, **values), fixes, seed=7)
    inputs = change(world) if change else world.inputs
    return Simulated(inputs, lambda **changes: world.params(**{**(always or {}), **changes}))


def _late() -> Simulated:
    """0 to 62 s late in any order: some are too old; one in ten is lost.

    The published noise filters start from stated variances, else they diverge at once.
    """
    fixes = FixSpec(period_s=1.5, delay_kind='uniform', delay_s=62.0, loss=0.1, leader_sigma=0.5)
    return _sins(150.0, fixes, always={'published_start': 100.0})


def _dense() -> Simulated:
    """A fix every 0.1 s, up to 2 s late: several within one step of the filter."""
    return _sins(30.0, FixSpec(delay_kind='steps', delay_steps=20))


def _outliers() -> Simulated:
    """Every sixth fix is 1 m to 30 m off; DVL and depth have outliers too."""

    def change(world: World) -> Any:
        rng = np.random.default_rng(3)
        x = world.inputs
        x.dvl_v_m[rng.integers(0, len(x.dvl_v_m), 20)] += 1.0
        x.depth[rng.integers(0, len(x.depth), 20)] += 5.0
        fixes = [
            replace(f, r_e=f.r_e + 10.0 ** rng.uniform(0.0, 1.5) * rng.normal(size=3))
            if f.sequence % 6 == 5
            else f
            for f in x.fixes
        ]
        return replace(x, fixes=tuple(fixes))

    return _sins(80.0, FixSpec(delay_kind='uniform', delay_s=10.0, period_s=0.7), change)


def _duplicates() -> Simulated:
    """Packets twice, damaged, from the future, without numbers, of two leaders."""

    def change(world: World) -> Any:
        return replace(world.inputs, fixes=_mishaps(world.inputs.fixes))

    return _sins(80.0, FixSpec(delay_kind='uniform', delay_s=4.0, period_s=0.8), change)


def _mishaps(fixes: Iterable[Fix]) -> tuple[Fix, ...]:
    none = {'r_e': np.full(3, np.nan), 'covariance_e': np.full((3, 3), np.nan), 'polar': None}
    found: list[Fix] = []
    for fix in fixes:
        found.append(fix)
        kind = fix.sequence % 12
        if kind in (1, 6):  # the same packet again: at once, or later
            found.append(replace(fix, receive_ns=fix.receive_ns + (kind > 1) * 7 * NS // 10))
        elif kind == 3:
            refused = {'refusal': Verdict.BAD_CRC, 'reason': 'made for this test'}
            found[-1] = replace(fix, validity_ns=0, transmit_ns=0, **refused, **none)
        elif kind == 5:
            found[-1] = replace(fix, validity_ns=fix.receive_ns + NS)
        elif kind == 8:  # the same number from somebody else
            found.append(replace(fix, source='another', receive_ns=fix.receive_ns + NS // 5))
        elif kind == 10:
            found[-1] = replace(fix, **none)
    found.sort(key=lambda fix: fix.receive_ns)
    return tuple(replace(fix, arrival=k) for k, fix in enumerate(found))


def _dvl_lost() -> Simulated:
    """No bottom lock from 30 s to 60 s and now and then; no ping at all from 70 s to 80 s."""

    def change(world: World) -> Any:
        x = world.inputs
        t = (x.dvl_stamps_ns - x.imu_stamps_ns[0]) / NS
        x.dvl_valid[((t > 30.0) & (t < 60.0)) | (np.arange(len(t)) % 17 == 0)] = False
        return _without(x, 'dvl', (t > 70.0) & (t < 80.0))

    return _sins(90.0, FixSpec(delay_kind='uniform', delay_s=6.0, period_s=2.0), change)


def _imu_gap() -> Simulated:
    """IMU gaps of 0.06 s, and of 0.6 s near the end, a stamp twice; fixes are valid within."""

    def change(world: World) -> Any:
        x = world.inputs
        x.imu_stamps_ns[1234] = x.imu_stamps_ns[1233]
        gap = np.zeros(len(x.imu_stamps_ns), dtype=bool)
        gap[2000:2003] = gap[3000:3030] = True
        return _without(x, 'imu', gap)

    return _sins(80.0, FixSpec(delay_kind='uniform', delay_s=3.0, period_s=0.5), change)


def _unusable() -> Simulated:
    """Not a number, infinite, variances of zero and less, in every stream."""

    def change(world: World) -> Any:
        x = world.inputs
        x.omega_ib_b[[0, 500, 501], 1] = np.nan
        x.f_b[[700, 2500], 2] = np.inf
        x.dvl_v_m[[10, 200], 0] = np.nan
        x.dvl_covariance_m[[20, 210], 1, 1] = (0.0, -1.0)
        x.dvl_covariance_m[30, 0, 1] = np.inf
        x.depth[[5, 100]] = (np.nan, -np.inf)
        x.depth_variance[[6, 7, 101]] = (0.0, -1.0, np.nan)
        return x

    return _sins(70.0, FixSpec(delay_kind='uniform', delay_s=3.0, period_s=0.9), change)


def _refused() -> Simulated:
    """Pings that swing far beyond their sigma from 10 s on; at 50 s a blow that the IMU feels."""

    def change(world: World) -> Any:
        x = world.inputs
        t = (x.dvl_stamps_ns - x.imu_stamps_ns[0]) / NS
        swing = 0.15 * np.sin(0.4 * np.pi * t) * ((t > 10.0) & (t < 45.0))
        x.dvl_v_m[:, 1:] += swing[:, None]
        t = (x.imu_stamps_ns - x.imu_stamps_ns[0]) / NS
        x.f_b[(t > 50.0) & (t < 50.2)] += (30.0, 15.0, 10.0)
        return x

    return _sins(80.0, FixSpec(delay_kind='uniform', delay_s=3.0, period_s=0.9), change)


def _kicked() -> Simulated:
    """A sample whose rate leaps, and at 30 s a turn that the gyros measure and that never was."""

    def change(world: World) -> Any:
        x = world.inputs
        t = (x.imu_stamps_ns - x.imu_stamps_ns[0]) / NS
        x.omega_ib_b[[700, 900, 901], 1] += (2.0, -3.0, -3.0)
        x.omega_ib_b[(t > 30.0) & (t < 30.2), 0] += 0.25
        return x

    return _sins(80.0, FixSpec(delay_kind='uniform', delay_s=3.0, period_s=0.9), change)


def _diverging() -> Simulated:
    """One sample of the IMU that no filter survives, at 20 s."""

    def change(world: World) -> Any:
        world.inputs.f_b[1000] = 1e300
        return world.inputs

    fixes = FixSpec(delay_kind='uniform', delay_s=3.0, period_s=0.9)
    return _sins(30.0, fixes, change, {'max_specific_force': 1e300})


def _over_pole() -> Simulated:
    """Over the north pole after 45 s; a slow error of the USBL is estimated."""

    def change(world: World) -> Any:
        fixes = tuple(replace(f, array_heading=0.1 * f.sequence) for f in world.inputs.fixes)
        return replace(world.inputs, fixes=fixes)

    fixes = FixSpec(delay_kind='uniform', delay_s=8.0, period_s=1.0)
    place = {'latitude_deg': 89.99879, 'longitude_deg': 60.0, 'imu': 'paper_6_2'}
    return _sins(90.0, fixes, change, {'usbl_bias_sigma': 0.5}, **place)


def _model_aided() -> Simulated:
    """Thrust and a vehicle model beside the SINS, no DVL from 30 s to 60 s."""

    def change(world: World) -> Any:
        x = world.inputs
        t = (x.dvl_stamps_ns - x.imu_stamps_ns[0]) / NS
        x.dvl_valid[(t > 30.0) & (t < 60.0)] = False
        stamps = world.truth.start_ns + NS // 10 * np.arange(800, dtype=np.int64)
        force_b = np.array([world.truth.thrust(int(stamp))[:3] for stamp in stamps])
        force_b[400] = np.nan
        return replace(
            x,
            control_stamps_ns=stamps,
            control_force_b=force_b,
            control_torque_b=np.zeros_like(force_b),
        )

    fixes = FixSpec(delay_kind='uniform', delay_s=5.0, period_s=1.3)
    return _sins(80.0, fixes, change, {'model_aiding': True}, mission='model_aided')


def _station() -> Simulated:
    """Late packets in any order, some lost or off; identifications by number and by service."""

    def change(x: Any) -> Any:
        return replace(x, fixes=tuple(_far_off(x.fixes)))

    return _of_station(0.0, change, random_delay_s=8.0, loss=0.1)


def _station_odd() -> Simulated:
    """6 s later, with packets twice, damaged and far off; gaps and unusable samples."""

    def change(x: Any) -> Any:
        x = replace(
            x,
            omega_ib_b=x.omega_ib_b.copy(),
            C_b_G=x.C_b_G.copy(),
            force_b=x.force_b.copy(),
            depth=x.depth.copy(),
            depth_variance=x.depth_variance.copy(),
            fixes=_mishaps(_far_off(x.fixes)),
        )
        x.omega_ib_b[300, 1] = x.C_b_G[500, 0, 0] = x.force_b[700, 2] = x.depth[900] = np.nan
        x.depth_variance[1000] = 0.0
        gap = np.zeros(len(x.imu_stamps_ns), dtype=bool)
        gap[4000:4150] = True
        return _without(x, 'imu', gap)

    return _of_station(6.0, change, random_delay_s=4.0)


def _far_off(fixes: Iterable[Fix]) -> Iterable[Fix]:
    """Make every seventh range 90 m too long, which the gate refuses, and every fifth 25 m."""
    for fix in fixes:
        off_m = 90.0 * (fix.sequence % 7 == 4) + 25.0 * (fix.sequence % 5 == 2)
        assert fix.polar is not None
        yield replace(fix, polar=replace(fix.polar, range=fix.polar.range + off_m))


def _of_station(
    later_s: float, change: Callable[[Any], Any] | None = None, **scenario: Any
) -> Simulated:
    choices = StationChoices()
    world = make_station_world(
        choices.scenario(120.0, **scenario), 7, choices.depth_sigma, later_s
    )
    inputs = change(world.inputs) if change else world.inputs
    start_ns = int(world.inputs.imu_stamps_ns[0])
    commands = tuple(
        Command(start_ns + second * NS, k, CommandKind.IDENTIFY)
        for k, second in enumerate((25, 100))
    )
    always = {'identify_least_fixes': 15, 'identify_fixes': 30, 'identify_every': 5}
    return Simulated(
        inputs, lambda **changes: world.params(choices, later_s, **always, **changes), commands
    )


def _without(inputs: Any, stream: str, rows: np.ndarray) -> Any:
    """Leave some samples of a stream out."""
    names = {
        'imu': ('imu_stamps_ns', 'omega_ib_b', 'f_b', 'C_b_G'),
        'dvl': ('dvl_stamps_ns', 'dvl_v_m', 'dvl_covariance_m', 'dvl_valid'),
    }[stream]
    kept = {n: getattr(inputs, n)[~rows] for n in names if hasattr(inputs, n)}
    return replace(inputs, **kept)


MAKERS = {
    'late': _late,
    'dense': _dense,
    'outliers': _outliers,
    'duplicates': _duplicates,
    'dvl lost': _dvl_lost,
    'imu gap': _imu_gap,
    'unusable': _unusable,
    'refused': _refused,
    'kicked': _kicked,
    'diverging': _diverging,
    'over the pole': _over_pole,
    'model aided': _model_aided,
    'station': _station,
    'station odd': _station_odd,
}
