"""Smoothing of whole runs: arrival does not matter, the end is the filter's, errors as stated."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of
from scipy import stats

from polar_nav_core import attitude, earth, grid, spilled
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine import smoothing
from polar_nav_core.engine.sins import tape
from polar_nav_core.errors import ConfigError

X = slice(6, 9)


@pytest.fixture(scope='module')
def world():
    return World(150.0, leg_s=40.0)


def late(world, delay, seed=3, **changes):
    return inputs_of(world, world.fixes(2.0, delay, rng=np.random.default_rng(seed), **changes))


def same(a, b):
    for name in engine_run.Track.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)


def test_how_late_fixes_came_does_not_matter(world):
    params, inputs = world.params(configuration='default'), late(world, 0.0)
    soon = smoothing.smooth(params, inputs).track
    rng = np.random.default_rng(8)
    for delays in (np.full(len(inputs.fixes), 5_000_000_000), rng.integers(0, 60, 200) * 10**9):
        fixes = [
            replace(f, transmit_ns=f.validity_ns + int(d), receive_ns=f.validity_ns + int(d))
            for f, d in zip(inputs.fixes, delays, strict=False)
        ]
        rng.shuffle(fixes)
        same(smoothing.smooth(params, replace(inputs, fixes=tuple(fixes))).track, soon)


def test_a_run_in_many_stretches_is_that_in_one(world, monkeypatch):
    params, inputs = world.params(configuration='default'), late(world, 3.0)
    stretches = []
    took = tape.Tape.take
    monkeypatch.setattr(tape.Tape, 'take', lambda self: (took(self), stretches.append(1))[0])
    whole = smoothing.smooth(params, inputs, covariances=True)
    few = len(stretches)
    monkeypatch.setattr(smoothing, 'LOOK_S', 7.0)
    parts = smoothing.smooth(params, inputs, covariances=True)
    assert len(stretches) - few > 4 * few
    same(parts.track, whole.track)
    np.testing.assert_array_equal(parts.information, whole.information)


def test_a_part_of_a_run_may_have_no_state(world, monkeypatch):
    """As the last tenths of a second of a recording had behind a gap: a traceback."""
    params, inputs = world.params(configuration='default'), late(world, 3.0)
    monkeypatch.setattr(smoothing, '_TRACK_S', 30.0)
    whole = smoothing.smooth(params, inputs, every_s=30.0)
    monkeypatch.setattr(smoothing, 'LOOK_S', 7.0)
    same(smoothing.smooth(params, inputs, every_s=30.0).track, whole.track)


@pytest.mark.parametrize('most_bytes', [0, 1 << 20, 1 << 26])
def test_a_record_in_memory_or_in_a_file_is_written_over_that_of_a_tape_before(world, most_bytes):
    params, inputs = world.params(configuration='default'), late(world, 3.0)
    whole = smoothing.smooth(params, inputs, passes=1)
    with spilled.Spool(most_bytes) as used:
        used.room(1000)[:] = np.arange(1000.0)
        used.keep(used.room(1000))
        passes = smoothing._Passes(params, inputs, 1.0, False, record=used)
        for _ in range(2):
            same(passes._pass(passes._stated, None, None).back.track, whole.track)
        assert used.in_memory == (most_bytes > 1 << 20)


def test_it_is_the_filter_at_the_end_and_surer_before(world):
    params, inputs = world.params(configuration='default', output_period_s=1.0), late(world, 0.0)
    # In the first pass, which weights fixes as the filter does.
    found = smoothing.smooth(params, inputs, covariances=True, passes=1).track
    filtered = engine_run.run(params, inputs).track
    _, mine, its = np.intersect1d(found.stamps_ns, filtered.stamps_ns, return_indices=True)
    assert len(mine) > 140
    smooth_P = np.einsum('nii->ni', found.P[mine])
    filter_P = np.einsum('nii->ni', filtered.P[its])
    # At its own stamp a row of the filter has what was measured there, the smoothed one all of it.
    assert (smooth_P[:, :18] <= filter_P[:, :18] * (1.0 + 1e-6)).all()
    # In the middle the future says about as much as the past, which has the start besides.
    assert smooth_P[75, X].sum() < 0.6 * filter_P[75, X].sum()
    last = found.r_e[mine[-1]] - filtered.r_e[its[-1]]
    sigma = np.sqrt(filter_P[-1, X].sum())
    assert np.linalg.norm(last) < 0.1 * sigma


@pytest.mark.parametrize('sigma', [300.0, 1000.0, 2000.0])
def test_what_is_known_before_the_first_fix_does_not_depend_on_how_wide_the_start_was(sigma):
    """Of a start known to a kilometre variances before the first fix were rounding, below zero."""
    world, found = World(40.0), []
    for stated in (30.0, sigma):
        params = world.params(configuration='default', initial_sigma_position=stated)
        fixes = [f for f in world.fixes(1.0, 0.5) if f.validity_ns > world.stamps[0] + 15 * 10**9]
        found.append(smoothing.smooth(params, inputs_of(world, fixes), covariances=True).track)
    assert np.isfinite(found[1].derived).all()
    narrow, wide = (np.einsum('nii->ni', track.P)[:, X] for track in found)
    np.testing.assert_allclose(wide, narrow, rtol=0.01, atol=1e-6)


def test_smoothed_errors_are_no_larger_than_stated(world):
    params = world.params(configuration='default', output_period_s=1.0)
    nees, after, before = [], 0.0, 0.0
    for seed in range(12):
        inputs = inputs_of(world, world.fixes(2.0, 2.0, rng=np.random.default_rng(seed)), seed)
        found = smoothing.smooth(params, inputs, covariances=True).track
        filtered = engine_run.run(params, inputs).track
        k = 75
        truth = world.r_e[int(np.searchsorted(world.stamps, found.stamps_ns[k]))]
        e = found.r_e[k] - truth
        nees.append(e @ np.linalg.solve(found.P[k][X, X], e))
        j = int(np.searchsorted(filtered.stamps_ns, found.stamps_ns[k]))
        after += e @ e
        before += np.sum((filtered.r_e[j] - truth) ** 2)
    # Its start and IMU are better than stated; what fixes and DVL err is as stated.
    assert sum(nees) < stats.chi2.ppf(0.9995, 3 * len(nees))
    assert after < 0.7 * before


def test_measured_headings_are_smoothed_with_their_bias(world):
    """A compass that is off, and a start that is: fixes under way show both, also backwards."""
    rng = np.random.default_rng(4)
    ks = np.arange(100, world.n + 1, 100)
    lat, lon, _ = earth.geodetic_from_ecef(np.array(world.r_e)[ks])
    own = np.array([np.arctan2(world.C_b_G[k][0, 0], world.C_b_G[k][1, 0]) for k in ks])
    measured = own + grid.convergence(lat, lon) + np.radians(3.0 + rng.normal(0.0, 0.3, len(ks)))
    inputs = replace(
        late(world, 0.0),
        heading_stamps_ns=world.stamps[ks],
        headings=measured,
        heading_up_b=np.full((len(ks), 3), np.nan),
    )
    params = world.params(
        configuration='default',
        output_period_s=1.0,
        heading_reference='true',
        heading_markov_sigma_deg=0.1,
        initial_sigma_heading_deg=3.0,
    )
    off = replace(params, initial_grid_heading_deg=params.initial_grid_heading_deg + 2.0)
    found = smoothing.smooth(off, inputs, covariances=True).track
    filtered = engine_run.run(off, inputs).track
    assert found.P[:, 2, 2].max() < filtered.P[0, 2, 2]
    for k in range(len(found.stamps_ns)):
        j = int(np.searchsorted(world.stamps, found.stamps_ns[k]))
        turn = attitude.log(found.C_b_G[k] @ world.C_b_G[j].T)[2]
        assert abs(turn) < 4.0 * np.sqrt(found.P[k, 2, 2])
    assert not found.P[:, 21:].any()
    assert not found.sensor_errors[:, 12:].any()


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'configuration': 'modified_akf'}, 'adaptive_r'),
        ({'mode': 'station'}, 'mode'),
    ],
)
def test_what_it_cannot_smooth_is_named(world, changes, words):
    params = replace(world.params(), **changes)
    with pytest.raises(ConfigError, match=words):
        smoothing.smooth(params, late(world, 1.0))
