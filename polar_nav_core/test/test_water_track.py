"""Velocity through the water without bottom lock: less the estimated current, never as lock."""

import dataclasses

import numpy as np
import pytest
from closed_loop import run
from model_twin import LOW_COST, Voyage

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.verdicts import Verdict

pytestmark = pytest.mark.slow

GAP = (60.0, 180.0)


@pytest.fixture(scope='module')
def voyage():
    return Voyage(200.0)


def with_water(voyage, inputs, gaps=(GAP,), sigma=0.01, seed=3):
    """The same inputs, whose pings in the gaps are of the water."""
    rng = np.random.default_rng(seed)
    k = (inputs.dvl_stamps_ns - voyage.stamps[0]) // 10_000_000
    t = k * 0.01
    water = np.any([(t >= begin) & (t < end) for begin, end in gaps], axis=0)
    v_m = inputs.dvl_v_m.copy()
    through = voyage.v_G[k] - voyage.current_G[k]
    v_r = np.einsum('tji,tj->ti', voyage.C_b_G[k], through)
    v_m[water] = (v_r + rng.normal(0.0, sigma, v_r.shape))[water]
    covariance = inputs.dvl_covariance_m.copy()
    covariance[water] = sigma**2 * np.eye(3)
    return dataclasses.replace(
        inputs,
        dvl_v_m=v_m,
        dvl_covariance_m=covariance,
        dvl_valid=inputs.dvl_valid & ~water,
        dvl_water=water,
    )


def sailed(voyage, *, water, thrust=False, seed=1, **changes):
    """Track of a run with neither lock nor fixes in the gap."""
    rng = np.random.default_rng(seed)
    params = voyage.params(LOW_COST, rng, model_aiding=True, **changes)
    inputs = voyage.inputs(rng, LOW_COST, gap=GAP, fix_gap=GAP)
    if water:
        inputs = with_water(voyage, inputs)
    if not thrust:
        inputs = dataclasses.replace(
            inputs,
            control_stamps_ns=inputs.control_stamps_ns[:0],
            control_force_b=inputs.control_force_b[:0],
            control_torque_b=inputs.control_torque_b[:0],
        )
    return params, inputs


def errors(voyage, track):
    error, P, t = voyage.errors(track)
    inside = (t >= GAP[0] + 5.0) & (t < GAP[1])
    nees = np.einsum('ti,tij,tj->t', error, np.linalg.inv(P), error)
    return np.linalg.norm(error, axis=1)[inside], nees[inside]


@pytest.mark.parametrize('thrust', [False, True])
def test_it_bounds_the_velocity_where_the_bottom_is_out_of_range(voyage, thrust):
    """Two minutes without lock and fixes, in a current of 0.47 m/s: metres, and as stated."""
    seeds, ends, nees, current = (1, 2, 3), {}, [], []
    for water in (False, True):
        ends[water] = []
        for seed in seeds:
            params, inputs = sailed(voyage, water=water, thrust=thrust, seed=seed)
            result = engine_run.run(params, inputs)
            assert not result.divergence
            assert all(r.verdict is Verdict.FUSED for r in result.receipts)
            off, normalized = errors(voyage, result.track)
            ends[water].append(off[-1])
            if water:
                nees.append(normalized[-1])
                current.append(result.track.model[-1, 12:14] - voyage.current_G[-1, :2])
    assert max(ends[True]) < 5.0
    assert np.median(nees) < 2.5
    assert np.abs(current).max() < 0.03
    if not thrust:  # only the model of the water is left, and half of it is the pings
        assert np.median(ends[True]) < 0.3 * np.median(ends[False])


def some(inputs, seconds):
    """The first part of a run."""
    end_ns = int(inputs.imu_stamps_ns[0] + seconds * 1e9)
    cut = {}
    for name, stamps in (
        ('imu', ('imu_stamps_ns', 'omega_ib_b', 'f_b')),
        ('dvl', ('dvl_stamps_ns', 'dvl_v_m', 'dvl_covariance_m', 'dvl_valid', 'dvl_water')),
        ('depth', ('depth_stamps_ns', 'depth', 'depth_variance')),
        ('control', ('control_stamps_ns', 'control_force_b', 'control_torque_b')),
    ):
        used = getattr(inputs, f'{name}_stamps_ns') <= end_ns
        cut |= {field: getattr(inputs, field)[used] for field in stamps}
    fixes = tuple(f for f in inputs.fixes if f.receive_ns <= end_ns)
    return dataclasses.replace(inputs, fixes=fixes, **cut)


def flapping(voyage, **changes):
    """30 s whose pings change between bottom and water, with odd ones among them."""
    rng = np.random.default_rng(4)
    params = voyage.params(LOW_COST, rng, model_aiding=True, configuration='custom', **changes)
    gaps = (5.0, 12.0), (15.0, 15.5), (20.0, 24.0)
    again = some(with_water(voyage, voyage.inputs(rng, LOW_COST), gaps), 30.0)
    water = np.flatnonzero(again.dvl_water)
    again.dvl_v_m[water[5]] = np.nan
    again.dvl_v_m[water[20]] += 3.0  # refused by the gate
    return params, again


@pytest.mark.parametrize('name', ['ignore', 'tagged', 'back_propagate', 'rewind'])
def test_a_run_from_arrays_gives_the_bits_of_event_by_event(voyage, name):
    params, inputs = flapping(voyage, delay_handling=name)
    fast, slow = (engine_run.run(params, inputs, one_by_one=one) for one in (False, True))
    for field in engine_run.Track.__dataclass_fields__:
        np.testing.assert_array_equal(
            getattr(fast.track, field), getattr(slow.track, field), field
        )
    for one, other in zip(fast.receipts, slow.receipts, strict=True):
        assert (one.verdict, one.sequence) == (other.verdict, other.sequence)
        np.testing.assert_equal(one.nis, other.nis)
    [bad] = [r for r in fast.receipts if r.topic == 'dvl/data']
    assert bad.verdict is Verdict.NOT_FINITE


def test_rewind_equals_in_order_processing_to_the_bit(voyage):
    ends = []
    for name, late in (('rewind', True), ('ignore', False)):
        params, inputs = flapping(voyage, delay_handling=name, gate_probability=0.9999)
        if not late:
            fixes = tuple(dataclasses.replace(f, receive_ns=f.validity_ns) for f in inputs.fixes)
            inputs = dataclasses.replace(inputs, fixes=fixes)
        engine = Engine(params)
        last = [e for e in run(engine, inputs.events()) if isinstance(e, Estimate)][-1]
        ends.append((last, engine.fusion.filter.state.model.tobytes()))
    (a, model), (b, other) = ends
    for field in ('r_e', 'v_G', 'C_b_G', 'P', 'gyro_bias_b'):
        assert getattr(a, field).tobytes() == getattr(b, field).tobytes(), field
    assert model == other


def test_it_is_no_bottom_lock_and_counts_apart(voyage):
    params, inputs = flapping(voyage, delay_handling='back_propagate')
    engine = Engine(params)
    out = [e for e in run(engine, inputs.events()) if isinstance(e, Estimate)]
    t = np.array([(e.stamp_ns - voyage.stamps[0]) * 1e-9 for e in out])
    lock = np.array([e.model.bottom_lock for e in out])
    assert not lock[(t > 6.6) & (t < 12.3)].any()
    assert lock[(t > 14.0) & (t < 19.9)].all()  # half a second of water pings is none lost
    bottom = np.count_nonzero(inputs.dvl_valid)
    assert sum(e.local_statistics[0, 0] for e in out) == bottom - 4  # two of each return
    # Of the first 1.5 s of each gap none is used: there is lock.
    assert 40 <= engine.fused['dvl_water'] <= 43
    assert engine.gated['dvl_water'] == 1
    warned = Engine(params)
    list(run(warned, some(inputs, 10.0).events()))
    assert 'velocity through the water' in warned.aiding_warning or not warned.aided.knows_thrust


@pytest.mark.parametrize('changes', [{'model_aiding': False}, {'water_track_sigma': 0.0}])
def test_without_a_current_it_is_refused_with_a_receipt(voyage, changes):
    params, inputs = flapping(voyage, delay_handling='back_propagate')
    params = dataclasses.replace(params, **changes)
    receipts = [r for r in run(Engine(params), inputs.events()) if isinstance(r, Receipt)]
    refused = [r for r in receipts if r.topic == 'dvl/data']
    assert len(refused) == np.count_nonzero(inputs.dvl_water)
    assert {r.verdict for r in refused} == {Verdict.NOT_READY}
    assert 'water_track_sigma' in refused[0].reason


def test_what_lasts_in_it_is_no_white_noise(voyage):
    """A hundred pings say as much as their slow error leaves, not ten times as much as one."""
    sigmas = {}
    for tau in (0.0, 60.0):
        params, inputs = sailed(
            voyage, water=True, thrust=True, water_track_sigma=0.05, water_track_tau=tau
        )
        track = engine_run.run(params, some(inputs, 90.0)).track
        sigmas[tau] = np.sqrt(np.trace(track.P[-1, 3:5, 3:5]))
    assert sigmas[60.0] > sigmas[0.0]
