"""Runs that the frozen matrix is made of: two recorded bags and twelve simulated worlds.

Each run has a name, ``world / variant``. Everything of the packages that the matrix needs is
imported here and nowhere else in it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.configurations import STATION_VARIANTS
from polar_nav_core.engine.events import Command, CommandKind, Fix, Verdict
from polar_nav_core.engine.params import (
    COMPILED_NOISE,
    CONFIGURATIONS,
    DELAY_HANDLING,
    NOISE_ADAPTATION,
    NOISE_OF,
    ROBUST_FIXES,
    EngineParams,
)
from polar_nav_core.error_model import X
from polar_nav_tools.bags import Bag, open_bag
from polar_nav_tools.bags.arrays import estimates_from_cdr, receipts_from_cdr
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.station.world import make_world as make_station_world
from polar_nav_tools.experiments.station_choices import StationChoices
from polar_nav_tools.experiments.world import World, make_world
from polar_nav_tools.experiments.world_spec import WorldSpec
from polar_nav_tools.replay.by_message import replay

NS = 1_000_000_000
BAGS = Path(__file__).resolve().parents[1] / 'bags'

_TRACK = (
    'stamps_ns', 'r_e', 'v_G', 'C_b_G', 'P', 'sensor_errors', 'local_statistics', 'fixes', 'model',
)  # fmt: skip
_STATION_TRACK = (
    'stamps_ns', 'r_e', 'v_G', 'C_b_G', 'P', 'x', 'P_x', 'walk', 'weight', 'tally', 'fixes',
)  # fmt: skip
_RECEIPT = (
    'stamp_ns', 'verdict', 'topic', 'source', 'sequence', 'validity_ns', 'transmit_ns',
    'receive_ns', 'fused_ns', 'delay_handling', 'steps_rolled_back', 'innovation_G',
    'innovation_variance_G', 'nis', 'dof', 'gate', 'revision',
)  # fmt: skip
_IDENTIFICATION = (
    'stamp_ns', 'method', 'verdict', 'trigger', 'fixes', 'first_validity_ns', 'last_validity_ns',
    'names', 'values', 'covariance', 'condition_number', 'cost', 'iterations',
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """What a run gave, independent of the classes that carry it.

    Attributes
    ----------
    parts : mapping of str to value
        What is hashed, part by part: arrays, numbers, texts, bytes and sequences of them.
    stamps_ns, r_e, v_G : (k,), (k, 3), (k, 3) arrays
        Estimates: position, ECEF [m]; velocity, grid axes [m/s].
    sigma_r, sigma_v : (k, 3) arrays
        Their 1-sigma, per axis [m], [m/s].
    verdicts : mapping of str to int
        Receipts per verdict.
    """

    parts: Mapping[str, Any]
    stamps_ns: np.ndarray
    r_e: np.ndarray
    v_G: np.ndarray
    sigma_r: np.ndarray
    sigma_v: np.ndarray
    verdicts: Mapping[str, int]


def cpu_key() -> dict[str, str]:
    """Return what the bits depend on besides the code: processor, numba, numpy."""
    features = numba.config.CPU_FEATURES or llvm.get_host_cpu_features().flatten()
    return {
        'cpu': numba.config.CPU_NAME or llvm.get_host_cpu_name(),
        'features': features,
        'numba': numba.__version__,
        'numpy': np.__version__,
    }


# Simulated worlds --------------------------------------------------------------------------------


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


def _diverging() -> Simulated:
    """One sample of the IMU that no filter survives, at 20 s."""

    def change(world: World) -> Any:
        world.inputs.f_b[1000] = 1e300
        return world.inputs

    return _sins(30.0, FixSpec(delay_kind='uniform', delay_s=3.0, period_s=0.9), change)


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


_MAKERS = {
    'late': _late,
    'dense': _dense,
    'outliers': _outliers,
    'duplicates': _duplicates,
    'dvl lost': _dvl_lost,
    'imu gap': _imu_gap,
    'unusable': _unusable,
    'diverging': _diverging,
    'over the pole': _over_pole,
    'model aided': _model_aided,
    'station': _station,
    'station odd': _station_odd,
}


@lru_cache(maxsize=1)
def _simulated(world: str) -> Simulated:
    return _MAKERS[world]()


# Variants ----------------------------------------------------------------------------------------


def _custom(delay: str, noise: str, robust: str) -> tuple[str, dict[str, Any]]:
    changes = {
        'configuration': 'custom',
        'delay_handling': delay,
        'noise_adaptation': noise,
        'robust_fixes': robust,
    }
    return f'{delay} {noise} {robust}', changes


_ALL_NOISE = ('late', 'dense', 'outliers', 'unusable', 'over the pole')
"""Worlds with the noise adaptations that are not compiled: they take longer than all others."""


def _sins_variants(world: str) -> dict[str, dict[str, Any]]:
    """Every configuration; every delay handling with every noise and every robust weight."""
    aided = world == 'model aided'
    noises = NOISE_ADAPTATION if world in _ALL_NOISE else COMPILED_NOISE
    out = {
        name: {'configuration': name}
        for name, c in CONFIGURATIONS.items()
        if c.noise_adaptation in noises
    }
    for delay in DELAY_HANDLING:
        if aided and delay == 'clone':
            continue
        allowed = [n for n in noises[1:] if n in NOISE_OF.get(delay, NOISE_ADAPTATION)]
        out |= dict(_custom(delay, 'none', robust) for robust in ROBUST_FIXES)
        robust = cycle(ROBUST_FIXES[1:])
        out |= dict(_custom(delay, noise, next(robust)) for noise in allowed)
    return out


def _station_variants() -> dict[str, dict[str, Any]]:
    custom = [_custom(d, 'none', robust) for d in DELAY_HANDLING for robust in ROBUST_FIXES]
    return {
        'default': STATION_VARIANTS['default'],
        'published': STATION_VARIANTS['published'],
        **dict(custom),
        'single current': {'current_method': 'single', 'station_adaptation': 'always'},
        'travel time': {'station_validity': 'travel_time', 'station_heading_sigma_deg': 1.0},
        'published shifted': {'station_filter': 'published', 'published_fifo': 'shifted'},
    }


def _simulate(world: str, changes: Mapping[str, Any], *, one_by_one: bool) -> Run:
    simulated = _simulated(world)
    params = simulated.params(**changes)
    if params.mode == 'station':
        result = engine_run.run(
            params, simulated.inputs, commands=simulated.commands, one_by_one=one_by_one
        )
        identified = result.identifications
        names = {n: n for n in _STATION_TRACK} | {'tally': 'local_statistics'}
        track = {n: getattr(result.track, name) for n, name in names.items()}
    else:
        result = engine_run.run(params, simulated.inputs, one_by_one=one_by_one)
        identified = ()
        track = {n: getattr(result.track, n) for n in _TRACK}
    sigma = np.sqrt(np.abs(np.diagonal(track['P'], axis1=1, axis2=2)))
    parts = {
        'estimates': track,
        'receipts': [[getattr(r, n) for n in _RECEIPT] for r in result.receipts],
        # Apart from the numbers, so that other words change nothing but this.
        'words': [result.divergence, *(r.reason for r in (*result.receipts, *identified))],
    }
    if identified:
        parts['identified'] = [[getattr(i, n) for n in _IDENTIFICATION] for i in identified]
    return Run(
        parts=parts,
        stamps_ns=track['stamps_ns'],
        r_e=track['r_e'],
        v_G=track['v_G'],
        sigma_r=sigma[:, X.dr_e],
        sigma_v=sigma[:, X.dv_G],
        verdicts=Counter(r.verdict.name for r in result.receipts),
    )


# Recorded bags -----------------------------------------------------------------------------------

_TOPICS = {
    'estimates': 'nav/state',
    'receipts': 'nav/receipt',
    'model': 'nav/model',
    'identified': 'nav/identification',
}


@lru_cache(maxsize=1)
def _bag(name: str) -> Bag:
    return open_bag(BAGS / name)


def _replay(name: str, changes: Mapping[str, Any]) -> Run:
    """Replay message by message; what is hashed are the bytes that `./polar verify` hashes."""
    result = replay(_bag(name), changes=changes)
    messages = {part: result.of(topic) for part, topic in _TOPICS.items()}
    estimates = estimates_from_cdr(messages['estimates'], result.vehicle)
    return Run(
        parts={part: b''.join(data) for part, data in messages.items() if data},
        stamps_ns=estimates.stamp_ns,
        r_e=estimates.r_e,
        v_G=estimates.v_G,
        sigma_r=np.sqrt(np.diagonal(estimates.P_position_G, axis1=1, axis2=2)),
        sigma_v=np.sqrt(np.diagonal(estimates.P_velocity_G, axis1=1, axis2=2)),
        verdicts=Counter(r.verdict_text for r in receipts_from_cdr(messages['receipts'])),
    )


# All of it ---------------------------------------------------------------------------------------

BAG_NAMES = {'bag reference': 'reference', 'bag station': 'station'}
WORLDS = (*BAG_NAMES, *_MAKERS)


def variants_of(world: str) -> dict[str, dict[str, Any]]:
    """Return changes of parameters by the name of the variant."""
    if world == 'bag reference':
        named = {name: {'configuration': name} for name in CONFIGURATIONS}
        return named | dict(_custom(d, 'none', 'huber') for d in DELAY_HANDLING)
    if world == 'bag station':
        return {n: c for n, c in _station_variants().items() if _in_short(c)}
    return _station_variants() if world.startswith('station') else _sins_variants(world)


def in_short(world: str) -> dict[str, dict[str, Any]]:
    """Return the variants of a world that both drivers run: of robust weights, one.

    Noise that is not compiled runs event by event in any case. Both drivers of bags are compared
    in `test_fast_replay.py` and `test_station_bag.py`.
    """
    if world in BAG_NAMES:
        return {}
    return {name: c for name, c in variants_of(world).items() if _in_short(c)}


def _in_short(changes: Mapping[str, Any]) -> bool:
    if changes.get('configuration') == 'custom':
        return changes['noise_adaptation'] == 'none' and changes['robust_fixes'] == 'mahalanobis'
    noise = CONFIGURATIONS[changes.get('configuration', 'default')].noise_adaptation
    return noise in COMPILED_NOISE


def run(world: str, variant: str, *, one_by_one: bool = False) -> Run:
    """Run one variant in one world."""
    changes = variants_of(world)[variant]
    if world in BAG_NAMES:
        return _replay(BAG_NAMES[world], changes)
    return _simulate(world, changes, one_by_one=one_by_one)
