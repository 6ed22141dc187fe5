"""Measured headings: rows against differences, bias against least squares, gate, whole runs."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of, run
from compiled import jit_only

from polar_nav_core import earth, grid
from polar_nav_core.attitude import exp
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.health.conditions import Culprit
from polar_nav_core.engine.methods import DELAY_HANDLING
from polar_nav_core.engine.sins.filter import NavigationFilter
from polar_nav_core.engine.start.model import SAME_AGAIN
from polar_nav_core.error_model import X
from polar_nav_core.errors import ConfigError
from polar_nav_core.kernels.sins import heading as kh
from polar_nav_core.kernels.sins import state as fs

DEG = np.pi / 180.0


@pytest.fixture(scope='module')
def world():
    return World(12.0, lat_deg=60.0, lon_deg=10.0)


def grid_heading(C_b_G):
    return float(np.arctan2(C_b_G[0, 0], C_b_G[1, 0]))


def true_headings(world, every=10):
    """Stamps, true headings and verticals of a world, without any error."""
    ks = np.arange(every, world.n + 1, every)
    lat, lon, _ = earth.geodetic_from_ecef(np.array(world.r_e)[ks])
    own = np.array([grid_heading(world.C_b_G[k]) for k in ks])
    up_b = np.array([world.C_b_G[k][2] for k in ks])
    return world.stamps[ks], own + grid.convergence(lat, lon), up_b


def with_headings(inputs, stamps, headings, up_b):
    return replace(inputs, heading_stamps_ns=stamps, headings=headings, heading_up_b=up_b)


def heading_of(result, row=-1):
    return grid_heading(result.track.C_b_G[row])


@pytest.mark.parametrize('reference', ['true', 'magnetic', 'grid', 'arbitrary'])
@pytest.mark.parametrize('lat_deg', [60.0, -89.9])
def test_rows_are_the_slopes_of_the_innovation(reference, lat_deg):
    """H against differences of the kernel's own innovation by each error of the estimate."""
    pytest.importorskip('pygeomag', reason='the field model is not installed')
    world = World(0.1, lat_deg=lat_deg, lon_deg=10.0)
    params = world.params(heading_reference=reference, initial_pitch_deg=20.0)
    f = NavigationFilter(params, params.initial_state(), int(world.stamps[1]))
    s, c, w = f.state, f.settings, f.work

    def innovation(x):
        flat = s.flat.copy()
        s.C_b_G[:] = exp(-x[X.phi_G]) @ s.C_b_G  # estimate that is off by x
        s.r_e[:] += x[X.dr_e]
        s.usbl_bias_a[:] -= x[X.usbl_bias_a]  # the part of the error that is not known
        assert kh.heading_rows(s, c, w, f.stamp_ns, 0.3)
        z = float(w.z[0])
        s.flat[:] = flat
        return z

    assert kh.heading_rows(s, c, w, f.stamp_ns, 0.3)
    H = w.H[0].copy()
    directions = [1e-5 * row for row in np.eye(24)[[0, 1, 2, 21, 22, 23]]]
    for axis in f.frames.C_e_G[:2]:  # the height is left out of the row
        directions.append(np.concatenate([np.zeros(6), 10.0 * axis, np.zeros(15)]))
    for x in directions:
        slope = (innovation(x) - innovation(-x)) / (2.0 * np.linalg.norm(x))
        expected = H @ x / np.linalg.norm(x)
        assert slope == pytest.approx(expected, rel=2e-2, abs=1e-9)


@pytest.mark.parametrize('axis', [0, 1])
def test_rows_of_the_vertical_are_its_slopes(axis):
    world = World(0.1, lat_deg=60.0)
    params = world.params(heading_reference='true', initial_roll_deg=3.0)
    f = NavigationFilter(params, params.initial_state(), int(world.stamps[1]))
    up_b = f.state.C_b_G[2].copy()
    C = f.state.C_b_G.copy()
    for k in range(3):
        phi = np.zeros(3)
        phi[k] = 1e-5
        f.state.C_b_G[:] = exp(-phi) @ C
        kh.tilt_rows(f.state, f.settings, f.work, up_b, axis)
        assert float(f.work.z[0]) / 1e-5 == pytest.approx(f.work.H[0, k], abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize('tilts', [False, True])
def test_common_errors_reach_a_heading_through_the_state_only(tilts):
    """What a smoother reads of its updates: rows of the measurement before are not in them."""
    world = World(0.1, lat_deg=60.0)
    params = world.params(
        heading_reference='grid', heading_tilts=tilts, dvl_misalignment_sigma_deg=0.3
    )
    f = NavigationFilter(params, params.initial_state(), int(world.stamps[1]), steps=True)
    s, w = f.state, f.work
    assert f.settings.considers
    before = 1e-6 * np.random.default_rng(1).normal(size=s.sensitivity.shape)
    s.sensitivity[:] = before
    w.J[:], w.moved[:] = 1.0, 1.0
    heading = grid_heading(s.C_b_G)
    args = (s, f.settings, f.past, w, f.log, f.stamp_ns, heading, s.C_b_G[2].copy())
    assert kh.heading_event(*args) == fs.FUSED
    numbers = f.log.numbers[f.log.ranks == fs.HEADING_RANK]
    assert len(numbers) == (3 if tilts else 1)
    first = int(numbers[0])
    np.testing.assert_allclose(f.log.moved[first, 0], f.log.H[first, 0] @ before, atol=1e-15)
    assert not f.log.moved[numbers, 1:].any()


def test_a_true_heading_corrects_a_wrong_one_at_any_longitude(world):
    """The sign of convergence and of the row: the heading goes to where the measurement is."""
    stamps, headings, up_b = true_headings(world)
    params = world.params(
        heading_reference='true', heading_bias_sigma_deg=0.01, heading_markov_sigma_deg=0.01,
        initial_sigma_heading_deg=20.0,
    )  # fmt: skip
    off = replace(params, initial_grid_heading_deg=params.initial_grid_heading_deg + 15.0)
    inputs = with_headings(inputs_of(world, []), stamps, headings, up_b)
    truth = grid_heading(world.C_b_G[-1])
    assert abs(heading_of(engine_run.run(params, inputs_of(world, []))) - truth) < 0.1 * DEG
    assert abs(heading_of(engine_run.run(off, inputs)) - truth) < 0.5 * DEG


def test_a_constant_bias_is_that_of_least_squares():
    """Heading known to 0.5 deg, compass off by 8: the split is that of a dense estimate."""
    world = World(6.0, lat_deg=60.0)
    stamps, headings, up_b = true_headings(world, every=100)
    params = world.params(
        heading_reference='true',
        initial_sigma_heading_deg=0.5,
        heading_bias_sigma_deg=5.0,
        heading_bias_tau=1e6,
        heading_markov_sigma_deg=1.0,
        heading_markov_tau=2.0,
        heading_sigma_deg=0.3,
        heading_turn_factor=0.0,
        dvl_sigma=10.0,
    )
    inputs = with_headings(
        replace(inputs_of(world, []), dvl_valid=np.zeros(30, dtype=bool)),
        stamps,
        headings + 8 * DEG,
        up_b,
    )
    result = engine_run.run(params, inputs)
    # Unknowns: heading error (constant: a navigation-grade gyro) and bias; measurements correlated
    # by the coloured error.
    t = (stamps - stamps[0]) * 1e-9
    R = (0.3 * DEG) ** 2 * np.eye(len(t))
    R += (1.0 * DEG) ** 2 * np.exp(-np.abs(t[:, None] - t[None, :]) / 2.0)
    A = np.tile([1.0, 1.0], (len(t), 1))
    prior = np.diag([(0.5 * DEG) ** 2, (5.0 * DEG) ** 2])
    S = A @ prior @ A.T + R
    x = prior @ A.T @ np.linalg.solve(S, np.full(len(t), 8 * DEG))
    P = prior - prior @ A.T @ np.linalg.solve(S, A @ prior)
    error = heading_of(result) - grid_heading(world.C_b_G[-1])
    assert error == pytest.approx(x[0], rel=0.02)
    assert result.track.P[-1][2, 2] == pytest.approx(P[0, 0], rel=0.02)


def test_a_start_from_the_same_compass_counts_its_heading_once(world):
    """An exact agreement of both says nothing: the heading stays as uncertain as the bias."""
    stamps, headings, up_b = true_headings(world, every=100)
    params = world.params(
        heading_reference='true',
        initial_sigma_heading_deg=SAME_AGAIN * 3.0,
        heading_bias_sigma_deg=3.0,
        heading_bias_tau=1e6,
        heading_markov_sigma_deg=1e-3,
        heading_sigma_deg=1e-3,
        heading_turn_factor=0.0,
        dvl_sigma=10.0,
    )
    inputs = replace(inputs_of(world, []), dvl_valid=np.zeros(60, dtype=bool))
    result = engine_run.run(params, with_headings(inputs, stamps, headings, up_b))
    sigma = np.sqrt(result.track.P[-1][2, 2])
    assert sigma == pytest.approx(0.97 * 3.0 * DEG, rel=0.01)


@jit_only
@pytest.mark.parametrize('name', DELAY_HANDLING)
@pytest.mark.parametrize('tilts', [False, True])
def test_whole_runs_are_those_of_single_events(world, name, tilts):
    stamps, headings, up_b = true_headings(world)
    headings = headings + np.random.default_rng(3).normal(0.0, 2.0 * DEG, len(stamps))
    headings[5] = np.nan
    headings[7] += 2.0
    up_b[20] = np.nan
    up_b[30] = 3.0
    inputs = with_headings(inputs_of(world, world.fixes(0.7, 1.1)), stamps, headings, up_b)
    params = world.params(
        configuration='custom', delay_handling=name, heading_reference='true',
        heading_period_s=0.3, heading_tilts=tilts, initial_sigma_heading_deg=3.0,
    )  # fmt: skip
    fast = engine_run.run(params, inputs)
    slow = engine_run.run(params, inputs, one_by_one=True)
    for field in engine_run.Track.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(fast.track, field), getattr(slow.track, field))
    assert [repr(r) for r in fast.receipts] == [repr(r) for r in slow.receipts]
    assert sum(r.topic == 'heading/data' for r in fast.receipts) == 2
    assert (fast.track.sensor_errors[:, 12:] == 0.0).all()


def test_headings_that_nobody_asked_for_change_nothing(world):
    stamps, headings, up_b = true_headings(world)
    plain = inputs_of(world, world.fixes(1.0, 1.0))
    both = [
        engine_run.run(world.params(), x)
        for x in (plain, with_headings(plain, stamps, headings, up_b))
    ]
    np.testing.assert_array_equal(both[0].track.P, both[1].track.P)


@jit_only
def test_a_rewound_run_is_that_of_fixes_in_time(world):
    """What `clone` and `rewind` make of late fixes beside headings is nearly the same."""
    stamps, headings, up_b = true_headings(world)
    rng = np.random.default_rng(4)
    fixes = world.fixes(0.9, 2.0, rng=rng)
    inputs = with_headings(inputs_of(world, fixes), stamps, headings + 3 * DEG, up_b)
    ends = {}
    for name in ('clone', 'rewind'):
        params = world.params(
            configuration='custom', delay_handling=name, heading_reference='true',
            initial_sigma_heading_deg=2.0,
        )  # fmt: skip
        ends[name] = engine_run.run(params, inputs).track
    sigma = np.sqrt(np.diagonal(ends['rewind'].P[-1])[:9])
    assert np.abs(ends['clone'].r_e[-1] - ends['rewind'].r_e[-1]).max() < 0.02 * sigma[6:9].max()
    np.testing.assert_allclose(np.sqrt(np.diagonal(ends['clone'].P[-1])[:9]), sigma, rtol=0.02)


def test_usbl_bias_and_headings_exclude_one_another(world):
    with pytest.raises(ConfigError, match='usbl_bias_sigma'):
        world.params(heading_reference='true', usbl_bias_sigma=1.0)


@jit_only
def test_a_magnetic_heading_without_a_field_is_refused():
    """80 N 120 E has 1,788 nT: no heading is used there, and the health says so."""
    pytest.importorskip('pygeomag', reason='the field model is not installed')
    for lat_deg, used in ((80.0, False), (-89.9, True)):
        place = World(12.0, lat_deg=lat_deg, lon_deg=120.0)
        stamps, headings, up_b = true_headings(place)
        params = place.params(heading_reference='magnetic')
        inputs = with_headings(inputs_of(place, []), stamps, headings, up_b)
        result = engine_run.run(params, inputs, look_every_s=1.0, one_by_one=True)
        keys = {p.condition.key for p in result.health[-1].present}
        assert ('compass weak' in keys) is not used


def test_a_state_saved_with_headings_resumes_without_and_with_them(world):
    """Nothing of the heading's errors is saved: the last three states begin anew."""
    stamps, headings, up_b = true_headings(world)
    params = world.params(heading_reference='true', initial_sigma_heading_deg=3.0)
    engine = Engine(params)
    run(engine, with_headings(inputs_of(world, []), stamps, headings + 5 * DEG, up_b).events())
    saved = engine.saved()
    assert engine.fusion.filter.state.usbl_bias_a[0] != 0.0
    after_ns = int(world.stamps[-1]) + 1_000_000_000
    with_them = NavigationFilter(params, saved, after_ns).state
    heading = float(with_them.P[2, 2])  # it may be of this compass: it does not count again
    assert 0.5 < np.sqrt(heading) / DEG < 4.0
    expected = (4.5 * DEG) ** 2 + SAME_AGAIN**2 * heading
    assert with_them.P[kh.BIAS, kh.BIAS] == pytest.approx(expected)
    sure = replace(saved, values={**saved.values, 'P': 1e-6 * saved.values['P']})
    beside = NavigationFilter(params, sure, saved.stamp_ns).state
    assert beside.P[kh.BIAS, kh.BIAS] == pytest.approx((4.5 * DEG) ** 2, rel=1e-3)
    without = NavigationFilter(world.params(), saved, after_ns).state
    np.testing.assert_array_equal(without.P[21:, 21:], np.eye(3))
    assert not with_them.usbl_bias_a.any()
    assert not without.usbl_bias_a.any()


def test_refused_headings_are_an_error_until_the_gate_opens_and_the_bias_takes_them(world):
    """A step of 90 deg: refused for three minutes, then used with another bias."""
    del world
    place = World(12.0, lat_deg=60.0, lon_deg=10.0)
    stamps, headings, up_b = true_headings(place, every=4)
    jump = (stamps > stamps[0] + 2_000_000_000) * 90 * DEG
    params = place.params(heading_reference='true', heading_period_s=0.04, reopen_after_s=2.0)
    inputs = with_headings(inputs_of(place, []), stamps, headings + jump, up_b)
    result = engine_run.run(params, inputs, look_every_s=1.0)
    keys = [{p.condition.key for p in h.present} for h in result.health]
    assert any('heading refused' in k for k in keys)
    assert 'heading reopened' in keys[-1]
    assert 'heading off' in keys[-1]
    assert all(
        p.condition.culprit == Culprit.HEADING
        for h in result.health
        for p in h.present
        if p.condition.key.startswith('heading')
    )
    assert abs(heading_of(result) - grid_heading(place.C_b_G[-1])) < 1.0 * DEG
