"""A whole run from arrays gives the bits of the same events one by one, odd ones included."""

import numpy as np
import pytest
from closed_loop import World, inputs_of
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_core import nav_columns
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.methods import CONFIGURATIONS, DELAY_HANDLING


@pytest.fixture(scope='module')
def world():
    return World(12.0)


def assert_same(a, b):
    for name in engine_run.Track.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(a.track, name), getattr(b.track, name), name)
    assert len(a.receipts) == len(b.receipts)
    for mine, yours in zip(a.receipts, b.receipts, strict=True):
        assert repr(mine) == repr(yours)
    assert a.divergence == b.divergence


def both(params, inputs):
    fast, slow = engine_run.run(params, inputs), engine_run.run(params, inputs, one_by_one=True)
    assert_same(fast, slow)
    return fast


@pytest.mark.parametrize('noise', ['none', 'adaptive_r'])
@pytest.mark.parametrize('name', DELAY_HANDLING)
def test_same_bits_for_each_strategy(world, name, noise):
    rng = np.random.default_rng(5)
    fixes = world.fixes(0.7, lambda _: rng.uniform(0.0, 3.0), rng=rng)
    params = world.params(
        configuration='custom',
        delay_handling=name,
        noise_adaptation=noise,
        gate_probability=0.95,
        robust_fixes='huber',
    )
    result = both(params, inputs_of(world, fixes))
    assert len(result.track.stamps_ns) == 121
    assert any(r.verdict == 0 for r in result.receipts)


@pytest.mark.parametrize('name', CONFIGURATIONS)
def test_same_bits_for_each_configuration(world, name):
    both(world.params(configuration=name), inputs_of(world, world.fixes(1.0, 1.5)))


COMMON = {
    'fix_range_scale_sigma': 0.003,
    'fix_offset_sigma': 2.0,
    'dvl_misalignment_sigma_deg': 0.3,
    'depth_offset_sigma': 0.2,
}


@pytest.mark.parametrize('robust', ['none', 'mahalanobis'])
@pytest.mark.parametrize('name', DELAY_HANDLING)
def test_same_receipts_with_common_errors(world, name, robust):
    """Their variances are what NIS is by, with the common errors: no axis alone exceeds it."""
    rng = np.random.default_rng(6)
    fixes = world.fixes(0.7, lambda _: rng.uniform(0.0, 3.0), rng=rng)
    chosen = {'delay_handling': name, 'robust_fixes': robust, 'gate_probability': 0.99}
    result = both(
        world.params(configuration='custom', **chosen, **COMMON), inputs_of(world, fixes)
    )
    judged = [r for r in result.receipts if np.isfinite(r.nis)]
    assert len(judged) > 5
    for r in judged:
        assert r.nis >= np.max(r.innovation_G**2 / r.innovation_variance_G) * (1.0 - 1e-12)


@pytest.mark.parametrize('one_by_one', [False, True])
def test_rows_with_derived_columns_in_place_of_covariances(world, one_by_one):
    params, inputs = world.params(), inputs_of(world, world.fixes(1.0, 1.5))
    full = engine_run.run(params, inputs).track
    slim = engine_run.run(params, inputs, derived=True, one_by_one=one_by_one).track
    derived = nav_columns.describe(full.r_e, full.C_b_G, full.P)
    np.testing.assert_array_equal(slim.derived, derived)
    assert len(slim.P) == len(full.derived) == 0
    for name in set(engine_run.Track.__dataclass_fields__) - {'P', 'derived'}:
        np.testing.assert_array_equal(getattr(slim, name), getattr(full, name), name)


@pytest.mark.parametrize('one_by_one', [False, True])
def test_rows_with_the_covariance_of_leading_states_only(world, one_by_one):
    params, inputs = world.params(), inputs_of(world, world.fixes(1.0, 1.5))
    full = engine_run.run(params, inputs).track
    slim = engine_run.run(params, inputs, states=9, one_by_one=one_by_one).track
    np.testing.assert_array_equal(slim.P, full.P[:, :9, :9])
    for name in set(engine_run.Track.__dataclass_fields__) - {'P'}:
        np.testing.assert_array_equal(getattr(slim, name), getattr(full, name), name)


@pytest.mark.parametrize('room', [1, 7, 60, 121])
def test_a_track_does_not_depend_on_how_many_rows_were_expected(world, room, monkeypatch):
    params, inputs = world.params(), inputs_of(world, world.fixes(1.0, 1.5))
    inputs.f_b[700] = np.nan
    expected = engine_run.run(params, inputs, one_by_one=True)
    monkeypatch.setattr(engine_run, '_outputs_of', lambda *_: room)
    assert_same(engine_run.run(params, inputs), expected)


def test_room_for_a_track_does_not_grow_with_a_pause(world):
    """Five days between two samples would be twenty gigabytes of covariances."""
    stamps = 10_000_000 * np.arange(1, 301)
    stamps[150:] += 5 * 86_400 * 10**9
    x = engine_run.Inputs(stamps, np.zeros((300, 3)), np.tile([0.0, 0.0, 9.8], (300, 1)))
    assert 30 <= engine_run._outputs_of(world.params(), x) <= 34


def test_columns_of_a_track_are_in_one_piece(world):
    track = engine_run.run(world.params(), inputs_of(world, [])).track
    for name in engine_run.Track.__dataclass_fields__:
        assert getattr(track, name).flags.c_contiguous, name


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32))
def test_same_bits_with_odd_measurements(world, seed):
    rng = np.random.default_rng(seed)
    fixes = world.fixes(0.9, lambda _: rng.uniform(0.0, 4.0), sigma=rng.choice([1.0, 40.0]))
    x = inputs_of(world, fixes, seed)
    for values in (x.omega_ib_b, x.dvl_v_m, x.dvl_covariance_m.reshape(-1, 9), x.depth[:, None]):
        values[rng.integers(0, len(values)), rng.integers(0, values.shape[1])] = rng.choice(
            [np.nan, np.inf]
        )
    x.depth_variance[rng.integers(0, len(x.depth))] = 0.0
    x.dvl_valid[rng.integers(0, len(x.dvl_valid), 5)] = False
    again = rng.integers(2, len(x.imu_stamps_ns), 2)
    x.imu_stamps_ns[again] = x.imu_stamps_ns[again - 1]
    name = str(rng.choice(DELAY_HANDLING))
    both(
        world.params(
            configuration='custom',
            delay_handling=name,
            gate_probability=0.99,
            imu_sample=str(rng.choice(['mean', 'instant'])),
            output_period_s=float(rng.choice([0.1, 0.25, 1.0])),
        ),
        x,
    )


@pytest.mark.parametrize('name', DELAY_HANDLING)
def test_a_lost_filter_is_restored_alike(world, name):
    x = inputs_of(world, world.fixes(1.0, 1.0))
    x.f_b[400] = 1e300
    chosen = {'configuration': 'custom', 'delay_handling': name}
    result = both(world.params(**chosen, max_specific_force=1e300), x)
    assert not result.divergence
    assert len(result.track.stamps_ns) == 121
    assert np.isfinite(result.track.P).all()
    late = 0.0 if name != 'ignore' else 3.0 * 1.0
    assert np.linalg.norm(result.track.r_e[-1] - world.r_e[-1]) < 1.0 + late


def test_no_measurements_at_all(world):
    x = engine_run.Inputs(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    assert len(both(world.params(), x).track.stamps_ns) == 0


LEVER_B = (1.2, -0.2, 0.3)


@pytest.mark.parametrize('imu_sample', ['mean', 'instant'])
@pytest.mark.parametrize('name', ['back_propagate', 'clone', 'rewind'])
def test_same_bits_of_an_imu_away_from_base_link(world, name, imu_sample):
    changes = {'configuration': 'custom', 'delay_handling': name, 'imu_sample': imu_sample}
    params, inputs = world.params(**changes), inputs_of(world, world.fixes(1.0, 1.5), 3)
    inputs.omega_ib_b[[300, 517], 1] = np.nan  # passed over
    fast, slow = (
        engine_run.run(params, inputs, one_by_one=one, imu_lever_b=LEVER_B)
        for one in (False, True)
    )
    assert_same(fast, slow)
    assert len(fast.track.stamps_ns) == 121
    for one in (False, True):
        slim = engine_run.run(
            params, inputs, one_by_one=one, derived=True, imu_lever_b=LEVER_B
        ).track
        full = fast.track
        derived = nav_columns.describe(full.r_e, full.C_b_G, full.P)
        np.testing.assert_array_equal(slim.derived, derived)
