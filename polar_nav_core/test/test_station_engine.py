"""Station mode under the engine: what goes in, what comes out, what is refused and why."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import station_twin as twin

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind, ImuSample
from polar_nav_core.engine.outputs import Estimate
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.errors import ConfigError
from polar_nav_core.identification.result import Identification

OFF = {'identify_method': 'none'}
WINDOW = (950.0, 1590.0)


@cache
def world(seconds=15.0):
    return twin.inputs(twin.truth(seconds), 1, depth_every=10)


def outputs(params, events):
    engine = Engine(params)
    found = [output for event in events for output in engine.process(event)]
    return engine, found


def test_an_estimate_knows_what_it_does_not_know():
    _, found = outputs(twin.params(**OFF), world().events())
    e = [o for o in found if isinstance(o, Estimate)][-1]
    assert np.isnan(e.P[9:]).all()
    assert np.isnan(e.P[:, 9:]).all()
    assert np.linalg.eigvalsh(e.P[:9, :9]).min() > 0.0
    assert np.isnan(e.gyro_bias_b).all()
    m = e.model
    np.testing.assert_allclose(m.v_r_b + e.C_b_G.T @ m.current_G, e.C_b_G.T @ e.v_G, atol=1e-3)
    assert m.drag_linear_sigma > 0.0
    assert -1.0 < m.drag_correlation < 1.0
    assert np.isnan(m.current_covariance_G[2]).all()
    assert e.local_statistics[1, 0] == 1.0


def test_velocity_and_its_covariance_follow_from_the_state():
    """P of velocity against samples of the state's distribution."""
    params = twin.params(**OFF, station_attitude_sigma_deg=0.0)
    track = engine_run.run(params, world()).track
    k, n = -1, 20000
    x = np.random.default_rng(0).multivariate_normal(track.x[k], track.P_x[k], n)
    c, s = np.cos(x[:, 10] - track.x[k, 10]), np.sin(x[:, 10] - track.x[k, 10])
    # psi of the estimate falls as its bias grows
    u = np.einsum('ij,nj->ni', track.C_b_G[k], x[:, :3])
    v = np.stack([c * u[:, 0] + s * u[:, 1], c * u[:, 1] - s * u[:, 0], u[:, 2]], axis=-1)
    v[:, :2] += x[:, 6:8]
    np.testing.assert_allclose(np.cov(v.T), track.P[k][3:6, 3:6], rtol=0.05, atol=2e-6)
    phi = x[:, 10] - track.x[k, 10]
    cross = np.mean(phi[:, None] * (v - v.mean(axis=0)), axis=0)
    sigma = np.sqrt(np.diagonal(track.P[k]))
    assert (np.abs(cross - track.P[k][2, 3:6]) < 0.03 * sigma[2] * sigma[3:6]).all()


@pytest.mark.parametrize('station_validity', ['packet', 'travel_time'])
@pytest.mark.parametrize(
    ('change', 'verdict', 'words'),
    [
        ({'polar': None}, Verdict.BAD_FORMAT, 'no range and bearing'),
        ({'range': math.nan}, Verdict.NOT_FINITE, 'not finite'),
        ({'range': math.inf}, Verdict.NOT_FINITE, 'not finite'),
        ({'range': 0.0}, Verdict.NOT_FINITE, 'range of 0.0 m'),
        ({'station': np.array([0.0, math.inf, 0.0])}, Verdict.NOT_FINITE, 'not finite'),
    ],
)
def test_a_fix_that_cannot_be_used(change, verdict, words, station_validity):
    good = world().fixes[1]
    polar = None if 'polar' in change else replace(good.polar, **change)
    inputs = replace(world(), fixes=(replace(good, polar=polar),))
    result = engine_run.run(twin.params(**OFF, station_validity=station_validity), inputs)
    (receipt,) = result.receipts
    assert receipt.verdict is verdict
    assert words in receipt.reason


def test_a_sample_without_attitude_is_refused():
    events = [replace(e, C_b_G=None) if isinstance(e, ImuSample) else e for e in world().events()]
    engine, found = outputs(twin.params(**OFF), events[:20])
    assert not engine.navigating
    assert 'no attitude' in found[0].reason


def test_odd_inputs_get_the_same_receipts_in_a_whole_run():
    x = world()
    omega, depth, C = x.omega_ib_b.copy(), x.depth.copy(), x.C_b_G.copy()
    force, stamps = x.force_b.copy(), x.imu_stamps_ns.copy()
    omega[0] = omega[300] = np.nan
    depth[20], C[500], force[700] = np.inf, np.nan, np.nan
    stamps[801] = stamps[800]
    odd = replace(x, omega_ib_b=omega, depth=depth, C_b_G=C, force_b=force, imu_stamps_ns=stamps)
    a = engine_run.run(twin.params(**OFF), odd)
    b = engine_run.run(twin.params(**OFF), odd, one_by_one=True)
    assert [str(r) for r in a.receipts] == [str(r) for r in b.receipts]
    assert {r.verdict for r in a.receipts} >= {Verdict.NOT_FINITE, Verdict.DUPLICATE}
    assert np.array_equal(a.track.x, b.track.x)
    assert np.array_equal(a.track.local_statistics, b.track.local_statistics)


# Plain Python says that a number overflows, compiled code does not.
@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_a_lost_filter_goes_on_in_a_whole_run_as_event_by_event():
    """With fixes before and after it: rows of before must not count those of after."""
    x = world()
    force = x.force_b.copy()
    force[600] = 1e300
    broken = replace(x, force_b=force)
    params = twin.params(**OFF, thrust_limit_n=1e300)
    a = engine_run.run(params, broken)
    b = engine_run.run(params, broken, one_by_one=True)
    assert a.divergence == b.divergence == ''
    assert np.isfinite(a.track.P[-1]).all()
    assert [str(r) for r in a.receipts] == [str(r) for r in b.receipts]
    for field in engine_run.StationTrack.__dataclass_fields__:
        assert np.array_equal(getattr(a.track, field), getattr(b.track, field)), field


def test_dated_by_travel_time():
    """Eq. 11 from the arrival: off by the range error over the sound speed."""
    result = engine_run.run(twin.params(**OFF, station_validity='travel_time'), world())
    plain = engine_run.run(twin.params(**OFF), world())
    off = [a.validity_ns - b.validity_ns for a, b in zip(result.receipts, plain.receipts,
                                                          strict=True)]  # fmt: skip
    assert 0.0 < np.abs(off).max() < 2.0 * 0.012 * 1000.0 / 1500.0 * 1e9


def test_noise_that_a_fix_leaves_open_comes_from_the_parameters():
    truth = twin.truth(15.0)
    stated = engine_run.run(twin.params(**OFF), twin.inputs(truth, 2))
    open_ = engine_run.run(twin.params(**OFF), twin.inputs(truth, 2, stated=False))
    np.testing.assert_allclose(stated.track.x[-1], open_.track.x[-1], rtol=1e-9)


@pytest.mark.slow
def test_heading_error_of_the_station_is_a_state_that_never_averages_out():
    fixes = tuple(
        replace(f, polar=replace(f.polar, station_heading_sigma=0.02))
        for f in twin.inputs(twin.truth(300.0), 1, depth_every=10).fixes
    )
    inputs = replace(twin.inputs(twin.truth(300.0), 1, depth_every=10), fixes=fixes)
    plain = engine_run.run(twin.params(**OFF), world(300.0)).track
    track = engine_run.run(twin.params(**OFF), inputs).track
    assert plain.P_x[-1, 11, 11] == 0.0
    assert 0.005 < math.sqrt(track.P_x[-1, 11, 11]) <= 0.0201
    # across the line of sight the position is no better than the heading
    p = track.x[-1, 3:5]
    across = np.array([-p[1], p[0]]) / np.hypot(*p)
    sigma = math.sqrt(across @ track.P_x[-1, 3:5, 3:5] @ across)
    assert sigma > 0.8 * math.sqrt(track.P_x[-1, 11, 11]) * np.hypot(*p)


def test_modes_and_filters_take_what_they_can():
    with pytest.raises(ConfigError, match='modified_akf does not go with mode station'):
        EngineParams(mode='station', configuration='modified_akf')
    with pytest.raises(ConfigError, match='adaptive_r does not go with mode station'):
        twin.params(configuration='custom', noise_adaptation='adaptive_r')
    with pytest.raises(ConfigError, match='rewind does not go with station_filter published'):
        twin.params(configuration='custom', delay_handling='rewind', station_filter='published')


def test_published_variants_differ_only_when_fixes_come_faster_than_their_delay():
    inputs = world()
    changes = {**OFF, 'station_filter': 'published'}
    kept = engine_run.run(twin.params(**changes), inputs).track.x
    shifted = engine_run.run(twin.params(**changes, published_fifo='shifted'), inputs).track.x
    np.testing.assert_allclose(kept, shifted, atol=0.02)
    late = tuple(replace(f, receive_ns=f.receive_ns + 4_000_000_000) for f in inputs.fixes)
    inputs = replace(inputs, fixes=late)
    kept = engine_run.run(twin.params(**changes), inputs).track.x
    shifted = engine_run.run(twin.params(**changes, published_fifo='shifted'), inputs).track.x
    assert np.abs(kept - shifted)[-1, 3:5].max() > 0.1


def identified(inputs, at, **changes):
    stamp_ns = twin.START_NS + round(at * 1e9)
    command = Command(stamp_ns, 0, CommandKind.IDENTIFY)
    params = twin.params(**changes)
    return params, command, engine_run.run(params, inputs, commands=[command])


@pytest.mark.slow
def test_identify_on_command_and_the_filter_takes_it():
    inputs = world(600.0)
    params, command, result = identified(inputs, 590.0, identify_share_sigma=0.3)
    (found,) = result.identifications
    assert found.trigger == 'command'
    assert found.verdict.name == 'ACCEPTED'
    after = result.track.stamps_ns > found.stamp_ns
    k = int(np.argmax(after))
    m = result.track.model(k, params)
    values = dict(zip(found.names, found.values, strict=True))
    assert m.drag_linear == pytest.approx(values['drag_linear'], rel=0.05)
    np.testing.assert_allclose(
        m.current_G[:2], [values['current_x'], values['current_y']], atol=0.003
    )
    one = engine_run.run(params, inputs, commands=[command], one_by_one=True)
    assert str(one.identifications) == str(result.identifications)
    assert np.array_equal(one.track.x, result.track.x)
    # without leave the filter goes its own way
    _, _, never = identified(inputs, 590.0, identify_share_sigma=0.3, station_adaptation='never')
    assert not np.array_equal(never.track.x[k], result.track.x[k])


def test_too_few_fixes_say_so():
    _, _, result = identified(world(), 10.0)
    (found,) = result.identifications
    assert found.verdict.name == 'TOO_FEW_FIXES'


def pooled(current, **changes):
    """RMS of position and velocity, mean NIS, largest error from 60 s on; 5 seeds.

    In the first minute the current is not known yet: 1-sigma across the line of sight is 5 m at
    30 s, so that one run of ten is off by more than 12 m there.
    """
    truth = twin.truth(1600.0, current)
    p, v, nis, worst = [], [], [], 0.0
    for seed in range(5):
        result = engine_run.run(twin.params(**changes), twin.inputs(truth, seed))
        t, dp, dv = twin.errors(result.track, truth)
        inside = (t >= WINDOW[0]) & (t <= WINDOW[1])
        p.append(dp[inside, :2])
        v.append(dv[inside, :2])
        nis += [r.nis for r in result.receipts if r.verdict is Verdict.FUSED]
        worst = max(worst, float(np.abs(dp[t > 60.0, :2]).max()))
        assert all(r.verdict is Verdict.FUSED for r in result.receipts)

    def rms(rows):
        return np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0))

    return rms(p), rms(v), float(np.mean(nis)), worst


SINGLE = {**OFF, 'current_method': 'single'}


# Of the simulation proper: polar_nav_tools/test/test_experiments_station.py, in the slow ring.
@pytest.mark.long
@pytest.mark.timeout(900)
def test_constant_current_at_full_noise():
    p, v, nis, worst = pooled('constant', **SINGLE, current_walk=1e-6)
    assert (p <= [2.2, 1.3]).all()
    assert (v <= [0.016, 0.013]).all()
    assert 1.8 <= nis <= 2.2
    assert worst <= 12.0


@pytest.mark.long
@pytest.mark.timeout(900)
def test_changing_current_at_full_noise():
    p, _, _, _ = pooled('changing', **SINGLE, current_walk=1e-5)
    assert (p <= [3.6, 3.0]).all()


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_default_is_good_for_both_currents():
    p, v, nis, _ = pooled('constant', **OFF)
    assert (p <= [2.2, 1.3]).all()
    assert (v <= [0.016, 0.013]).all()
    assert 1.8 <= nis <= 2.2
    p, _, _, _ = pooled('changing', **OFF)
    assert (p <= [3.6, 3.0]).all()


def test_identification_is_an_output_of_the_engine():
    engine = Engine(twin.params())
    found = list(engine.process(Command(1, 0, CommandKind.IDENTIFY)))
    assert isinstance(found[0], Identification)
    assert not engine.navigating
