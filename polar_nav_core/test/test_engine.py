"""The engine end to end, without ROS: late fixes, verdicts, order, the price of ignored delays."""

import dataclasses

import numpy as np
import pytest
from closed_loop import START_NS, World, gathered, inputs_of, run

from polar_nav_core import grid
from polar_nav_core.earth import geodetic_from_ecef
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind, Fix, ImuSample
from polar_nav_core.engine.health.conditions import Level
from polar_nav_core.engine.methods import CONFIGURATIONS
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.errors import ConfigError
from polar_nav_core.kernels.limits import EARTH

SPEED = np.hypot(2.0, 2.0)


@pytest.fixture(scope='module')
def world():
    return World(120.0)


def estimates(out):
    return [o for o in out if isinstance(o, Estimate)]


def receipts(out):
    return [o for o in out if isinstance(o, Receipt)]


def position_errors(world, track):
    index = {int(s): k for k, s in enumerate(world.stamps)}
    rows = []
    for stamp_ns, r_e in zip(track.stamps_ns, track.r_e, strict=True):
        k = index[int(stamp_ns)]
        rows.append(grid.ecef_to_grid(world.r_e[k]) @ (r_e - world.r_e[k]))
    return np.array(rows)


def sensors(world, seed=1):
    rng = np.random.default_rng(seed)
    return [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng)]


def second_half_rms(errors):
    half = errors[len(errors) // 2 :]
    return np.sqrt(np.mean(np.sum(half[:, :2] ** 2, axis=1)))


@pytest.mark.parametrize('delay_s', [pytest.param(1.0, marks=pytest.mark.slow), 2.5, 10.0])
def test_ignored_delay_costs_speed_times_delay_and_the_aware_filter_does_not_pay(world, delay_s):
    rng = np.random.default_rng(2)
    fixes = world.fixes(1.0, delay_s, rng=rng)
    late = {}
    for name in ('conventional_akf', 'modified_akf'):
        ran = engine_run.run(world.params(configuration=name), inputs_of(world, fixes))
        late[name] = second_half_rms(position_errors(world, ran.track))
    assert late['conventional_akf'] == pytest.approx(SPEED * delay_s, rel=0.1, abs=0.3)
    assert late['modified_akf'] < 0.5


@pytest.mark.parametrize(
    ('lat_deg', 'lon_deg'),
    [
        (90.0, 0.0),
        (-75.0, -180.0),
        *(
            pytest.param(*place, marks=pytest.mark.slow)
            for place in [(80.0, 120.0), (89.9995, 179.999), (-90.0, 0.0), (85.0, 180.0)]
        ),
    ],
)
def test_the_pole_and_the_date_line_are_ordinary_places(lat_deg, lon_deg):
    world = World(60.0, lat_deg, lon_deg)
    fixes = world.fixes(1.0, 3.0, rng=np.random.default_rng(3))
    ran = engine_run.run(world.params(configuration='default'), inputs_of(world, fixes))
    assert second_half_rms(position_errors(world, ran.track)) < 0.6
    assert {r.verdict for r in ran.receipts} == {Verdict.FUSED}


@pytest.mark.slow
def test_estimates_stay_inside_their_own_band(world):
    """Position errors against the filter's own sigma: last epochs of 24 runs, 3 dof each."""
    from scipy.stats import chi2

    total, runs = 0.0, 24
    for seed in range(runs):
        rng = np.random.default_rng(100 + seed)
        params = world.params(configuration='default')
        offset_G = rng.normal(0.0, [5.0, 5.0, 5.0])
        from polar_nav_core import earth

        start = world.r_e[1] + grid.ecef_to_grid(world.r_e[1]).T @ offset_G
        lat, lon, height = (float(v) for v in earth.geodetic_from_ecef(start))
        params = dataclasses.replace(
            params,
            initial_latitude_deg=np.rad2deg(lat).item(),
            initial_longitude_deg=np.rad2deg(lon).item(),
            initial_height=height,
        )
        events = [*world.imu()[:6000], *world.dvl(rng=rng)[:300], *world.depth(rng=rng)[:600]]
        events += [f for f in world.fixes(2.0, 3.0, rng=rng) if f.receive_ns <= world.stamps[6000]]
        track = engine_run.run(params, gathered(events)).track
        error = track.r_e[-1] - world.r_e[6000]
        total += error @ np.linalg.solve(track.P[-1, 6:9, 6:9], error)
    lo, hi = chi2.ppf([0.0005, 0.9995], 3 * runs)
    assert lo < total < hi


def test_every_fix_gets_one_receipt_and_each_verdict_has_its_reason(world):
    fixes = world.fixes(2.0, 3.0, rng=np.random.default_rng(4))
    good = fixes[20]
    nan = np.full(3, np.nan)

    def late_copy(i, **changes):
        return dataclasses.replace(
            good,
            order=1000 + i,
            arrival=1000 + i,
            sequence=changes.pop('sequence', 5000 + i),
            **changes,
        )

    odd = [
        late_copy(0, sequence=good.sequence),
        late_copy(1, validity_ns=good.receive_ns - 61_000_000_000),
        late_copy(2, validity_ns=good.receive_ns + 1),
        late_copy(3, r_e=nan),
        late_copy(4, r_e=good.r_e + 500.0),
        late_copy(5, refusal=Verdict.BAD_CRC, reason='CRC is wrong', validity_ns=0),
        late_copy(6, covariance_e=-np.eye(3)),
        late_copy(7, validity_ns=START_NS - 1_000_000_000, receive_ns=START_NS + 50_000_000_000),
    ]
    out = run(Engine(world.params(configuration='default')), sensors(world) + fixes + odd)
    got = receipts(out)
    assert len(got) == len(fixes) + len(odd)
    by_sequence = {r.sequence: r for r in got if r.sequence >= 5000}
    assert by_sequence[5001].verdict is Verdict.TOO_OLD
    assert by_sequence[5002].verdict is Verdict.FROM_FUTURE
    assert by_sequence[5003].verdict is Verdict.NOT_FINITE
    assert by_sequence[5004].verdict is Verdict.GATED
    assert by_sequence[5004].nis > by_sequence[5004].gate
    assert by_sequence[5005].verdict is Verdict.BAD_CRC
    assert by_sequence[5006].verdict is Verdict.NOT_FINITE
    assert by_sequence[5007].verdict is Verdict.TOO_OLD
    assert sum(r.verdict is Verdict.DUPLICATE for r in got) == 1
    assert all(r.reason for r in got)


def test_refused_fixes_change_nothing(world):
    fixes = world.fixes(2.0, 3.0, rng=np.random.default_rng(4))
    bad = [
        dataclasses.replace(f, r_e=f.r_e + 900.0, sequence=7000 + i, order=7000 + i)
        for i, f in enumerate(fixes[10:])
    ]
    clean = estimates(run(Engine(world.params(configuration='default')), sensors(world) + fixes))
    dirty = estimates(
        run(Engine(world.params(configuration='default')), sensors(world) + fixes + bad)
    )
    assert np.array_equal(clean[-1].r_e, dirty[-1].r_e)
    assert np.array_equal(clean[-1].P, dirty[-1].P)


def test_events_out_of_order_are_the_callers_fault(world):
    engine = Engine(world.params())
    first, second = world.imu()[:2]
    list(engine.process(second))
    with pytest.raises(ValueError, match='in order'):
        list(engine.process(first))


def test_bad_imu_samples_get_receipts(world):
    imu = world.imu()[:100]
    broken = ImuSample(imu[50].stamp_ns + 1, 1000, np.array([np.nan, 0, 0]), np.zeros(3))
    twice = dataclasses.replace(imu[60], sequence=1001)
    out = run(Engine(world.params()), [*imu, broken, twice])
    assert [r.verdict for r in receipts(out)] == [Verdict.NOT_FINITE, Verdict.DUPLICATE]


def test_reset_starts_again_from_the_given_state(world):
    at = int(world.stamps[5000])
    command = Command(at, 0, CommandKind.RESET)
    out = run(Engine(world.params()), [*sensors(world), command])
    after = next(e for e in estimates(out) if e.stamp_ns > at)
    assert after.stamp_ns == world.stamps[5001]
    # The parameters' state, not the present one.
    np.testing.assert_allclose(after.r_e, world.r_e[1], atol=1e-3)


def test_lost_definiteness_restores_the_newest_sound_state(world):
    engine = Engine(world.params())
    out = []
    for event in sorted(sensors(world)[:3000], key=lambda e: e.key):
        out.extend(engine.process(event))
        if len(out) == 50 and not engine.restored.count:
            engine.fusion.filter.state.P[7, 7] = -1.0
    assert not engine.divergence
    assert engine.restored.count == 1
    assert 'no longer positive definite' in engine.restored.why
    last = estimates(out)[-1]
    k = list(world.stamps).index(last.stamp_ns)
    off = np.linalg.norm(last.r_e - world.r_e[k])
    # Nothing aids it afterwards, and what the vehicle did in the lost second is not known.
    assert off < 5.0 * np.sqrt(np.trace(last.P[6:9, 6:9]))
    assert engine.health.level is Level.ERROR
    assert 'restored from the newest sound state' in engine.health.sentence


@pytest.mark.parametrize('even_the_newest_sound_one', [False, True])
def test_a_state_that_leaves_the_earth_is_restored_and_stays_on_it(
    world, even_the_newest_sound_one
):
    engine = Engine(world.params())
    out = []
    for event in sorted(sensors(world)[:3000], key=lambda e: e.key):
        out.extend(engine.process(event))
        own = engine.fusion.filter if len(out) == 50 else None
        if own is not None and np.linalg.norm(own.state.v_G) < 1e3 and not engine.restored.count:
            own.state.v_G[:] = 1e9
            if even_the_newest_sound_one:
                own.log.good_flat[0][: len(own.state.flat)] = own.state.flat
        engine.look()
    assert engine.navigating
    assert engine.restored.count == 1
    distances = [np.linalg.norm(e.r_e) for e in estimates(out)]
    assert all(EARTH[0] < distance < EARTH[1] for distance in distances[-50:])
    assert engine.health.level is Level.ERROR


@pytest.mark.slow
@pytest.mark.parametrize(('lat_deg', 'lon_deg'), [(30.0, -80.0), (1e-6, 90.0), (0.0, -90.000002)])
def test_an_absurd_start_raises_nothing_and_a_sane_one_later_navigates(world, lat_deg, lon_deg):
    """Elsewhere on the Earth, and half a metre from where grid north is undefined."""
    params = world.params(configuration='default')
    absurd = dataclasses.replace(
        params, initial_latitude_deg=lat_deg, initial_longitude_deg=lon_deg
    )
    fixes = world.fixes(1.0, 1.0, rng=np.random.default_rng(2))
    engine, out = Engine(absurd), []
    k = len(world.stamps) // 2
    lat, lon, height = geodetic_from_ecef(world.r_e[k])
    good = dataclasses.replace(
        params.initial_state(), latitude=float(lat), longitude=float(lon), height=float(height),
        v_G=tuple(world.v_G[k]), sigma_heading=0.1, sigma_position_horizontal=5.0,
    )  # fmt: skip
    command = Command(int(world.stamps[k]), 0, CommandKind.SET_INITIAL_STATE, good)
    for event in sorted([*sensors(world), *fixes, command], key=lambda e: e.key):
        out.extend(engine.process(event))
        if event is command:
            out.clear()
    found = estimates(out)
    index = {int(stamp_ns): k for k, stamp_ns in enumerate(world.stamps)}
    off = [float(np.linalg.norm(e.r_e - world.r_e[index[e.stamp_ns]])) for e in found]
    assert len(off) > 400
    assert max(off[len(off) // 2 :]) < 3.0


def test_a_configuration_is_what_its_name_says():
    assert CONFIGURATIONS['conventional_akf'].delay_handling == 'ignore'
    assert CONFIGURATIONS['modified_akf'].delay_handling == 'back_propagate'
    params = EngineParams(
        configuration='custom',
        delay_handling='ignore',
        noise_adaptation='none',
        gate_probability=0.99,
    )
    assert params.resolved().gate_probability == 0.99


def test_history_must_be_longer_than_the_longest_delay():
    with pytest.raises(ConfigError, match='history_s'):
        EngineParams(history_s=10.0, max_delay_s=20.0)


def test_fix_key_orders_by_reception(world):
    early, late = world.fixes(2.0, 3.0)[:2]
    swapped = dataclasses.replace(early, receive_ns=late.receive_ns + 1)
    assert early.key < late.key < swapped.key
    assert isinstance(swapped, Fix)


def test_a_fix_without_heading_cannot_feed_a_bias_in_array_axes(world):
    fixes = world.fixes(1.0, 1.0)
    out = run(Engine(world.params(usbl_bias_sigma=0.5)), sensors(world) + fixes)
    receipts = [o for o in out if isinstance(o, Receipt)]
    assert {r.verdict for r in receipts} == {Verdict.NOT_FINITE}
    assert 'usbl_bias_sigma' in receipts[0].reason
    with_heading = [dataclasses.replace(f, array_heading=0.3) for f in fixes]
    out = run(Engine(world.params(usbl_bias_sigma=0.5)), sensors(world) + with_heading)
    assert {o.verdict for o in out if isinstance(o, Receipt)} == {Verdict.FUSED}


@pytest.mark.parametrize('kind', [CommandKind.RESET, CommandKind.SET_INITIAL_STATE])
def test_a_start_that_is_stated_before_the_first_sample_of_an_imu_apart(world, kind):
    """Nothing is known of its rate yet, which would move the state from base_link to it."""
    params = world.params()
    stated = params.initial_state() if kind is CommandKind.SET_INITIAL_STATE else None
    engine = Engine(params, imu_lever_b=(1.0, 0.0, 0.5))
    list(engine.process(Command(int(world.stamps[0]), 0, kind, stated)))
    estimates = [
        o for s in world.imu()[:200] for o in engine.process(s) if isinstance(o, Estimate)
    ]
    assert engine.navigating
    assert estimates
