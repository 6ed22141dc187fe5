"""Gates that have closed on agreeing measurements open again; those that rightly closed do not."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import DvlPing
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.kernels import watch
from polar_nav_core.kernels.sins import state as fs

CONFIGURATION = {
    'configuration': 'custom',
    'delay_handling': 'clone',
    'gate_probability': 0.9999,
    'robust_fixes': 'mahalanobis',
    'initial_sigma_position': 5.0,
}


@pytest.fixture(scope='module')
def world():
    return World(60.0)


@pytest.fixture(scope='module')
def inputs(world):
    rng = np.random.default_rng(3)
    return inputs_of(world, world.fixes(1.0, lambda _: 0.5, rng=rng, first_s=1.0))


def run(world, inputs, **changes):
    params = world.params(**{**CONFIGURATION, **changes})
    return engine_run.run(params, inputs, look_every_s=1.0)


def pings(result, column):
    """DVL pings of the last 20 s: column 0 used, 1 refused."""
    stamps = result.track.stamps_ns
    late = stamps > stamps[-1] - 20 * 10**9
    return result.track.local_statistics[late, 0, column].sum()


def heading_off(world):
    start = world.params().initial_grid_heading_deg
    return {'initial_grid_heading_deg': start + 5.0, 'initial_sigma_heading_deg': 5.0 / 60.0}


def test_a_wrong_heading_does_not_shut_the_dvl_out_for_good(world, inputs):
    shut = run(world, inputs, **heading_off(world), reopen_after_s=0.0)
    assert pings(shut, 1) > 10.0 * pings(shut, 0)
    opened = run(world, inputs, **heading_off(world), reopen_after_s=10.0)
    assert pings(opened, 0) > 10.0 * pings(opened, 1)
    assert opened.health[-1].resets >= 1
    assert 'DVL' in opened.health[8].sentence
    assert all(h.level == 2 for h in opened.health[8:40])


def test_a_sound_run_opens_nothing(world, inputs):
    result = run(world, inputs)
    assert result.health[-1].resets == 0
    assert not any(h.present for h in result.health)


def moved(inputs, which, metres):
    """Fixes numbered by ``which`` moved along an axis of the Earth."""
    fixes = tuple(
        replace(f, r_e=f.r_e + np.array([metres, 0.0, 0.0])) if k in which else f
        for k, f in enumerate(inputs.fixes)
    )
    return replace(inputs, fixes=fixes)


def test_a_filter_that_locked_on_to_the_first_fixes_is_freed(world, inputs):
    """Three fixes 12 m off come first, at a sigma of 5 m; then only true ones."""
    off = moved(inputs, {0, 1, 2}, 12.0)
    shut = run(world, off, reopen_after_s=0.0, robust_fixes='none')
    assert shut.verdicts[Verdict.GATED] > 50
    freed = run(world, off, robust_fixes='none')
    assert freed.verdicts[Verdict.GATED] < 25
    assert freed.health[-1].resets == 1


def test_a_leader_that_is_displaced_later_is_not_believed(world, inputs):
    """Thirty agreeing fixes, then as many 40 m off: those stay refused."""
    result = run(world, moved(inputs, set(range(30, 60)), 40.0))
    assert result.verdicts[Verdict.GATED] >= 28
    assert result.health[-1].resets == 0
    assert 'displaced' in result.health[-1].sentence


def test_whole_runs_open_as_nodes_do(world, inputs):
    params = world.params(**{**CONFIGURATION, **heading_off(world)})
    whole, single = (
        engine_run.run(params, inputs, one_by_one=k, look_every_s=1.0) for k in (False, True)
    )
    np.testing.assert_array_equal(whole.track.P, single.track.P)
    np.testing.assert_array_equal(whole.track.r_e, single.track.r_e)
    assert whole.health == single.health
    assert len(whole.health) > 30


@pytest.mark.parametrize('handling', ['clone', 'rewind'])
def test_a_start_that_is_half_a_kilometre_off_moves_to_the_fixes(world, handling):
    """Fixes 3 s late: those that were on their way when the covariance grew count no more."""
    late = inputs_of(world, world.fixes(1.0, lambda _: 3.0, first_s=1.0))
    start = {'initial_latitude_deg': world.params().initial_latitude_deg + 500.0 / 111e3}
    result = run(world, late, **start, delay_handling=handling)
    assert result.health[-1].resets == 1
    assert np.linalg.norm(result.track.r_e[-1] - world.r_e[-1]) < 3.0
    (start_off,) = [p for p in result.health[-1].present if p.condition.key == 'start']
    assert 'the first fixes lay 503 m from the stated start' in start_off.condition.sentence


def contradicting(result, world, stamp_ns):
    """Error of the position in its published sigmas at a stamp, and the sigma [m]."""
    k = int(np.searchsorted(result.track.stamps_ns, stamp_ns))
    at = int(np.searchsorted(world.stamps, result.track.stamps_ns[k]))
    error = result.track.r_e[k] - world.r_e[at]
    P = result.track.P[k][6:9, 6:9]
    return float(np.sqrt(error @ np.linalg.solve(P, error))), float(np.sqrt(np.trace(P)))


def struck(inputs, start_s=20.0):
    """A blow of 4 g for 0.2 s that the IMU feels and the vehicle does not follow."""
    since_s = (inputs.imu_stamps_ns - inputs.imu_stamps_ns[0]) * 1e-9 - start_s
    hit = ((since_s >= 0.0) & (since_s < 0.2))[:, None] * np.array([40.0, 20.0, 10.0])
    return replace(inputs, f_b=inputs.f_b + hit)


def without_depths(inputs):
    """The same measurements, of depths only those of the first second."""
    k = int(np.searchsorted(inputs.depth_stamps_ns, inputs.depth_stamps_ns[0] + 10**9))
    names = ('depth_stamps_ns', 'depth', 'depth_variance')
    return replace(inputs, **{name: getattr(inputs, name)[:k] for name in names})


def scattered(inputs, start_s=20.0):
    """Pings that lie to both sides in turn: they agree on nothing."""
    since_s = (inputs.dvl_stamps_ns - inputs.dvl_stamps_ns[0]) * 1e-9 - start_s
    sides = np.where(np.arange(len(since_s)) % 2, 4.0, -4.0)
    wrong = (since_s >= 0.0)[:, None] * sides[:, None] * np.ones(3)
    return replace(inputs, dvl_v_m=inputs.dvl_v_m + wrong)


def fixes_until(inputs, end_s):
    """The same measurements, without the fixes after a time."""
    end_ns = inputs.imu_stamps_ns[0] + round(end_s * 1e9)
    return replace(inputs, fixes=tuple(f for f in inputs.fixes if f.receive_ns < end_ns))


def test_fixes_are_believed_where_the_watchdog_doubts_dvl_or_imu():
    """Pings that agree on nothing open their gate again and again: in most runs, not in all."""
    world, errors = World(110.0), []
    for seed in range(11, 15):
        rng = np.random.default_rng(seed)
        fixes = world.fixes(1.0, lambda _: 0.5, rng=rng, first_s=1.0)
        off = without_depths(scattered(struck(inputs_of(world, fixes))))
        result, shut = run(world, off), run(world, off, reopen_after_s=0.0)
        sentences = {p.condition.sentence for h in result.health for p in h.present}
        assert any(s.startswith('position fixes were refused until') for s in sentences)
        errors.append([late_error(r, world) for r in (result, shut)])
    found, without = np.median(errors, axis=0)
    assert without > 50.0 * found


def late_error(result, world):
    """Median error of the last 30 s [m]."""
    stamps_ns = result.track.stamps_ns
    late = np.flatnonzero(stamps_ns > stamps_ns[-1] - 30 * 10**9)
    true_e = np.array(world.r_e)[np.searchsorted(world.stamps, stamps_ns[late])]
    return float(np.median(np.linalg.norm(result.track.r_e[late] - true_e, axis=1)))


def test_a_displaced_leader_shows_in_the_published_covariance_only(world, inputs):
    off = moved(inputs, set(range(30, 60)), 40.0)
    result, sound = run(world, off), run(world, inputs)
    np.testing.assert_allclose(result.track.r_e[-1], sound.track.r_e[-1], atol=1.0)
    refused = [r for r in result.receipts if r.verdict is Verdict.GATED]
    size = contradicting(result, world, refused[4].stamp_ns + 10**8)[1]
    assert 30.0 < size < 60.0
    back = moved(inputs, set(range(30, 40)), 40.0)
    assert contradicting(run(world, back), world, sound.track.stamps_ns[-1])[1] < 3.0


def test_whole_runs_believe_fixes_as_nodes_do(world, inputs):
    faulty = struck(inputs)
    params = world.params(**CONFIGURATION)
    whole, single = (
        engine_run.run(params, faulty, one_by_one=k, look_every_s=1.0) for k in (False, True)
    )
    np.testing.assert_array_equal(whole.track.P, single.track.P)
    np.testing.assert_array_equal(whole.track.r_e, single.track.r_e)
    assert whole.health == single.health


def after_a_ping(world, memory, times):
    """Covariance after the eleventh ping, whose R is ``times`` the stated one.

    ``memory`` is what is remembered of thirty pings before it, by column; None: what there was.
    """
    engine = Engine(world.params(**CONFIGURATION))
    events = sorted([*world.imu(), *world.dvl()], key=lambda e: e.key)
    ping = [e for e in events if isinstance(e, DvlPing)][10]
    end_ns = ping.stamp_ns
    for event in events:
        if event.stamp_ns < end_ns:
            list(engine.process(event))
    list(engine.advance(end_ns - 1))
    state = engine.fusion.filter.state
    for column, value in (memory or {}).items():
        state.memories[fs.DVL_ROW, watch.SHORT, column] = value
    list(engine.process(replace(ping, covariance_m=times * ping.covariance_m)))
    list(engine.advance(end_ns + 1))
    assert state.tally[fs.DVL_ROW, fs.GATED] == 0.0
    return state.P.copy()


def test_a_ping_that_passes_among_refused_ones_has_the_noise_of_all(world):
    mostly = {watch.WEIGHT: 30.0, watch.REFUSED: 28.0, watch.NIS: 8.0 * 31.0 - 1.0}
    seldom = {**mostly, watch.REFUSED: 10.0}
    full, weak, kept = (after_a_ping(world, m, 1.0) for m in (None, mostly, seldom))
    np.testing.assert_array_equal(kept, full)
    assert weak[3, 3] > 1.01 * full[3, 3]
    keep = np.exp(-1.0 / 30.0)  # the ping itself is remembered before it is weighed
    mean = (keep * mostly[watch.NIS]) / (keep * 30.0 + 1.0)
    np.testing.assert_allclose(np.diag(weak), np.diag(after_a_ping(world, None, mean)), rtol=1e-4)


def first_opening_s(result, start_s=20.0):
    """Time from a blow to the first look that finds the DVL's gate opened again [s]."""
    for h in result.health:
        if any(p.condition.key == 'DVL reopened' for p in h.present):
            return (h.stamp_ns - result.track.stamps_ns[0]) * 1e-9 - start_s
    return np.inf


def test_pings_that_depths_back_are_believed_at_once(world, inputs):
    """Both contradict the IMU after a blow; a DVL alone waits while the last fix vouches."""
    backed = run(world, struck(inputs))
    assert 2.0 < first_opening_s(backed) < 12.0
    alone = run(world, fixes_until(without_depths(struck(inputs)), 20.0))
    assert first_opening_s(alone) == np.inf
    error = np.linalg.norm(backed.track.r_e[-1] - world.r_e[-1])
    assert error < 2.0
    assert contradicting(backed, world, backed.track.stamps_ns[-1])[0] < 4.0


def test_a_fix_vouches_for_a_minute_and_no_longer():
    """A tilt that is wrong while no fixes come: the DVL is believed in the end."""
    long = World(110.0)
    fixes = long.fixes(1.0, lambda _: 0.5, rng=np.random.default_rng(3), first_s=1.0)
    result = run(long, fixes_until(without_depths(kicked(inputs_of(long, fixes), 3.0, 0)), 20.0))
    assert 58.0 < first_opening_s(result) < 62.0
    end_ns = result.track.stamps_ns[-1]
    _, velocity, tilt = off(result, long, end_ns)
    assert (velocity < 0.2, tilt < 0.001) == (True, True)  # 0.12 m/s: no fix shows the heading
    assert contradicting(result, long, end_ns)[0] < 4.0


def heading_at_end(result, world):
    """Error of the heading at the end, and its published 1-sigma [rad]."""
    C = result.track.C_b_G[-1] @ world.C_b_G[-1].T
    return np.arctan2(C[1, 0] - C[0, 1], C[0, 0] + C[1, 1]), np.sqrt(result.track.P[-1, 2, 2])


UNDOUBTED = {'imu_shock': 0.0}
"""What a sample that leaps has done is in the covariance else, and no gate has to open."""


def kicked(inputs, deg, axis, length_s=0.1, start_s=20.0):
    """Gyros that measure a turn about an axis of the body which never was."""
    since_s = (inputs.imu_stamps_ns - inputs.imu_stamps_ns[0]) * 1e-9 - start_s
    hit = (since_s >= 0.0) & (since_s < length_s - 1e-6)
    rate = np.zeros((len(hit), 3))
    rate[:, axis] = np.radians(deg) / length_s * hit
    return replace(inputs, omega_ib_b=inputs.omega_ib_b + rate)


def off(result, world, stamp_ns):
    """Errors of position [m], velocity [m/s] and up [rad] at a stamp."""
    k = int(np.searchsorted(result.track.stamps_ns, stamp_ns))
    at = int(np.searchsorted(world.stamps, result.track.stamps_ns[k]))
    up, true_up = result.track.C_b_G[k][2], world.C_b_G[at][2]
    return (
        np.linalg.norm(result.track.r_e[k] - world.r_e[at]),
        np.linalg.norm(result.track.v_G[k] - world.v_G[at]),
        np.linalg.norm(np.cross(up, true_up)),
    )


@pytest.mark.parametrize(('deg', 'axis'), [(1.0, 0), (3.0, 0), (20.0, 0), (5.0, 1)])
def test_a_tilt_that_is_wrong_at_once_is_found_with_the_velocity(world, inputs, deg, axis):
    """Gravity leaks in by it, and would again, were only the velocity mended."""
    result = run(world, kicked(inputs, deg, axis), **UNDOUBTED)
    start_ns = int(result.track.stamps_ns[0])
    assert first_opening_s(result) < 14.0
    for found in (result, run(world, kicked(inputs, deg, axis))):
        position, velocity, tilt = off(found, world, start_ns + 45 * 10**9)
        assert (position < 3.0, velocity < 0.1, tilt < 0.001) == (True, True, True)
    assert contradicting(result, world, result.track.stamps_ns[-1])[0] < 4.0
    assert sum(h.resets for h in result.health[-1:]) <= 2


@pytest.mark.parametrize('seed', [3, 4])
@pytest.mark.parametrize('deg_per_h', [-100.0, 300.0])
def test_a_gyro_whose_bias_has_jumped_is_found_with_the_velocity(deg_per_h, seed):
    """By 700 to 2,000 of its stated sigmas; the DVL has agreed for more than a minute.

    Of 300 deg/h it may be the third opening, after 80 s, that finds it.
    """
    rate, world = deg_per_h / 3600.0, World(185.0)
    rng = np.random.default_rng(seed)
    inputs = inputs_of(world, world.fixes(1.0, lambda _: 0.5, rng=rng, first_s=1.0))
    result = run(world, kicked(inputs, rate * 140.0, 1, length_s=140.0, start_s=80.0))
    assert 80.0 < first_opening_s(result, 0.0) < 120.0
    error = result.track.sensor_errors[-1, 1] - np.radians(rate)
    assert abs(error) < 4.0 * np.sqrt(result.track.P[-1, 10, 10])
    _, velocity, attitude = off(result, world, result.track.stamps_ns[-1])
    assert velocity < 0.2
    assert attitude < 0.001


@pytest.mark.parametrize('seed', [3, 4])
def test_a_vertical_gyro_that_has_jumped_with_the_others_is_not_taken_for_known(seed):
    """Pings show nothing of it, and the heading goes on turning."""
    world = World(200.0)
    rng = np.random.default_rng(seed)
    inputs = inputs_of(world, world.fixes(1.0, lambda _: 0.5, rng=rng, first_s=1.0))
    rate = 100.0 / 3600.0
    for axis in (1, 2):
        inputs = kicked(inputs, rate * 120.0, axis, length_s=120.0, start_s=80.0)
    result = run(world, inputs)
    P, found = result.track.P[-1], result.track.sensor_errors[-1, :3]
    assert abs(found[2] - np.radians(rate)) < 4.0 * np.sqrt(P[11, 11])
    heading, sigma = heading_at_end(result, world)
    assert abs(heading) < 4.0 * sigma


@pytest.mark.parametrize('deg', [10.0, -40.0, 120.0])
def test_a_yaw_that_never_was_is_found_by_fixes(deg):
    """The DVL's gate opens, and fixes show within a minute how the vehicle lies."""
    long = World(100.0)
    fixes = long.fixes(1.0, lambda _: 0.5, rng=np.random.default_rng(7), first_s=1.0)
    result = run(long, kicked(inputs_of(long, fixes), deg, 2, length_s=1.0))
    assert first_opening_s(result) < 30.0
    error, sigma = heading_at_end(result, long)
    assert abs(error) < 4.0 * sigma
    assert sigma < np.radians(4.0)
    position, velocity, tilt = off(result, long, result.track.stamps_ns[-1])
    assert (position < 3.0, velocity < 0.2, tilt < 0.002) == (True, True, True)
    late_ns = result.track.stamps_ns[0] + 80 * 10**9
    assert contradicting(result, long, late_ns)[0] < 5.0


def test_fixes_refused_in_a_row_back_a_dvl_where_there_is_no_depth(world, inputs):
    alone = run(world, without_depths(kicked(inputs, 3.0, 0)), **UNDOUBTED)
    assert 4.0 < first_opening_s(alone) < 14.0
    assert off(alone, world, alone.track.stamps_ns[-1])[0] < 3.0


def test_one_sample_that_leaps_turns_nothing(world, inputs):
    """A rate of 3 rad/s in a single sample of 10 ms would be 1.7 deg."""
    spike = kicked(inputs, np.degrees(3.0) * 0.01, 0, length_s=0.01)
    result = run(world, spike)
    believed = run(world, spike, max_rate_leap=1e300, **UNDOUBTED)
    assert result.verdicts[Verdict.IMPLAUSIBLE] == 1
    assert first_opening_s(result) == np.inf
    assert off(result, world, result.track.stamps_ns[-1])[2] < 1e-4
    assert first_opening_s(believed) < 14.0


def test_late_fixes_right_after_an_opened_gate_find_what_it_made_of_the_covariance(world):
    """The gate opens with a ping, between two covariance steps; pings come every 0.2 s."""
    fixes = world.fixes(0.05, lambda _: 1.5, rng=np.random.default_rng(3), first_s=1.03)
    few = [f for k, f in enumerate(fixes) if (k % 60 == 0 and k < 380) or k > 556]
    result = run(world, kicked(inputs_of(world, few), 3.0, 0))
    start_ns = int(world.stamps[0])
    after = [r for r in result.receipts if (r.validity_ns - start_ns) * 1e-9 > 28.8]
    assert after[0].verdict is Verdict.GATED
    first = next(r for r in after if r.verdict is Verdict.FUSED)
    assert ((first.validity_ns - start_ns) * 1e-9) % 0.2 == pytest.approx(0.03, abs=1e-6)


@pytest.mark.parametrize('delay_s', [0.0, 1.5])
@pytest.mark.parametrize('doubt', ['all', 'position'])
def test_an_enlarged_covariance_is_that_of_late_fixes_as_well(world, doubt, delay_s):
    """Between two steps, with a fix right after it; `rewind` knows no stored covariance."""
    got = after_doubt(world, delay_s, doubt, 'clone')
    expected = after_doubt(world, 0.0, doubt, 'rewind')
    sigma = np.sqrt(np.diag(expected.P))
    assert np.all(np.abs(got.r_e - expected.r_e) < 0.02 * sigma[6:9])
    np.testing.assert_allclose(np.sqrt(np.diag(got.P)), sigma, rtol=0.01)


def after_doubt(world, delay_s, doubt, handling):
    """State 3 s after the covariance grew beside a ping and a fix 30 ms later."""
    changes = {'gate_probability': 1.0, 'delay_handling': handling}
    engine = Engine(world.params(**{**CONFIGURATION, **changes}))
    (fix, *_) = world.fixes(1000.0, lambda _: delay_s, first_s=8.03)
    rng = np.random.default_rng(1)
    events = [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng), fix]
    start_ns, doubted = int(world.stamps[0]), False
    for event in sorted(events, key=lambda e: e.key):
        since_s = (event.key[0] - start_ns) * 1e-9
        if since_s > 11.0:
            break
        list(engine.process(event))
        if since_s >= 8.0 and isinstance(event, DvlPing) and not doubted:
            list(engine.advance(event.stamp_ns))
            fusion = engine.fusion
            fusion.doubt_all(50.0) if doubt == 'all' else fusion.doubt_position(20.0)
            doubted = True
    list(engine.advance(start_ns + 11 * 10**9))
    assert doubted
    assert engine.fused['fix'] == 1
    return engine.fusion.filter.state
