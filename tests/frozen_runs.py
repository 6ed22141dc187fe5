"""Runs that the frozen matrix is made of: two recorded bags and twelve simulated worlds.

Each run has a name, ``world / variant``. Everything of the packages that the matrix needs is
imported here and in ``frozen_worlds.py``, and nowhere else in it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
from frozen_worlds import MAKERS, Simulated

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.configurations import STATION_VARIANTS
from polar_nav_core.engine.methods import (
    COMPILED_NOISE,
    CONFIGURATIONS,
    DELAY_HANDLING,
    NOISE_ADAPTATION,
    NOISE_OF,
)
from polar_nav_core.engine.params import ROBUST_FIXES
from polar_nav_core.error_model import X
from polar_nav_tools.bags import Bag, open_bag
from polar_nav_tools.bags.arrays import estimates_from_cdr, receipts_from_cdr
from polar_nav_tools.replay.by_message import replay

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


@lru_cache(maxsize=1)
def _simulated(world: str) -> Simulated:
    return MAKERS[world]()


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
_COMMON = {
    'fix_range_scale_sigma': 0.003,
    'fix_heading_sigma_deg': 0.3,
    'fix_clock_sigma': 0.05,
    'fix_offset_sigma': 0.5,
    'dvl_misalignment_sigma_deg': 0.5,
    'dvl_lever_sigma': 0.1,
    'dvl_latency_sigma': 0.05,
    'depth_offset_sigma': 0.5,
}
"""Errors in common that the worlds themselves state as zero."""


def _sins_variants(world: str) -> dict[str, dict[str, Any]]:
    """Every configuration; every delay handling with every noise and every robust weight."""
    aided = world == 'model aided'
    noises = NOISE_ADAPTATION if world in _ALL_NOISE else COMPILED_NOISE
    out = {
        name: {'configuration': name}
        for name, c in CONFIGURATIONS.items()
        if c.noise_adaptation in noises
    }
    out['default common'] = {'configuration': 'default', **_COMMON}
    if world in (
        'refused',
        'kicked',
    ):  # of a gate that opens: by rounding, others may open it elsewhere
        return {name: out[name] for name in ('default', 'default common')}
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
WORLDS = (*BAG_NAMES, *MAKERS)


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
