"""The vehicle's model in the engine: thrust, bottom lock, late fixes, the same bits each way."""

import dataclasses

import numpy as np
import pytest
from closed_loop import World, inputs_of, run
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import ControlSample, DvlPing, Rank
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.sins.rewind import Rewind
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.errors import ConfigError
from polar_nav_core.kernels.sins import state as fs

AIDED = ('ignore', 'tagged', 'back_propagate', 'rewind')


@pytest.fixture(scope='module')
def world():
    return World(12.0, v_G=(0.9, 0.7, 0.0))


def params(world, delay_handling='back_propagate', **changes):
    values = {'model_aiding': True, 'gate_probability': 0.9999, **changes}
    return world.params(configuration='custom', delay_handling=delay_handling, **values)


def thrust(world, every=10, first=5):
    return [
        ControlSample(
            int(world.stamps[k]),
            i,
            np.array([60.0 + 10.0 * np.sin(0.01 * k), 0.0, -6.0]),
            np.zeros(3),
        )
        for i, k in enumerate(range(first, world.n, every))
    ]


def sensors(world, seed=1):
    rng = np.random.default_rng(seed)
    return [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng), *thrust(world)]


def last(out):
    return [o for o in out if isinstance(o, Estimate)][-1]


def inputs_with_thrust(world, fixes):
    control = thrust(world)
    return dataclasses.replace(
        inputs_of(world, fixes),
        control_stamps_ns=np.array([c.stamp_ns for c in control]),
        control_force_b=np.array([c.force_b for c in control]),
        control_torque_b=np.array([c.torque_b for c in control]),
    )


# -- what it is made of ---------------------------------------------------------------------------


def test_without_model_aiding_thrust_changes_no_bit(world):
    p = world.params(configuration='default')
    fixes = world.fixes(1.0, 1.5, rng=np.random.default_rng(2))
    with_thrust = last(run(Engine(p), [*sensors(world), *fixes]))
    events = [e for e in sensors(world) if not isinstance(e, ControlSample)]
    without = last(run(Engine(p), [*events, *fixes]))
    for name in ('r_e', 'v_G', 'C_b_G', 'P', 'gyro_bias_b'):
        assert getattr(with_thrust, name).tobytes() == getattr(without, name).tobytes()
    assert with_thrust.model is None


def test_the_start_is_the_equation_itself(world):
    """v_r has the uncertainty of v_G and V_c, so that their difference has next to none."""
    p = params(world, initial_sigma_heading_deg=1.0)
    engine = Engine(p)
    run(engine, world.imu()[:1])
    f = engine.fusion.filter
    block = f.state.model
    P = np.block(
        [
            [f.state.P, block[fs.P_XE : fs.P_EE]],
            [block[fs.P_XE : fs.P_EE].T, block[fs.P_EE : fs.MEAN]],
        ]
    )[:29, :29]
    H = np.zeros((3, 29))
    C, v = f.state.C_b_G, f.state.v_G
    H[:, 0:3] = [[0.0, v[2], -v[1]], [-v[2], 0.0, v[0]], [v[1], -v[0], 0.0]]
    H[:, 3:6], H[:, 24:27] = np.eye(3), -C
    H[:2, 27:29] = -np.eye(2)
    left = H @ P @ H.T
    np.testing.assert_allclose(left, np.diag([0.0, 0.0, p.model_vertical_sigma**2]), atol=1e-12)
    np.testing.assert_allclose(C @ block[fs.MEAN, :3], v, atol=1e-15)
    assert block[fs.P_EE, 0] > p.current_sigma**2


def test_the_covariance_of_all_states_stays_positive_definite(world):
    engine = Engine(params(world))
    run(engine, [*sensors(world), *world.fixes(1.0, 1.5, rng=np.random.default_rng(2))])
    f = engine.fusion.filter
    P_xe, P_ee = f.state.model[fs.P_XE : fs.P_EE], f.state.model[fs.P_EE : fs.MEAN]
    assert np.array_equal(P_ee, P_ee.T)
    assert not P_xe[21:].any()  # the USBL bias is not in use
    P = np.delete(np.delete(joined(f), [21, 22, 23], 0), [21, 22, 23], 1)
    sigma = np.sqrt(np.diagonal(P))
    assert np.linalg.eigvalsh(P / np.outer(sigma, sigma))[0] > 1e-9


def joined(f):
    """Covariance of all 31 states."""
    P_xe, P_ee = f.state.model[fs.P_XE : fs.P_EE], f.state.model[fs.P_EE : fs.MEAN]
    return np.block([[f.state.P, P_xe], [P_xe.T, P_ee]])


@pytest.mark.parametrize('kind', ['dvl', 'depth', 'fix'])
def test_every_measurement_corrects_the_model_by_its_covariance(world, kind):
    """One event of the engine against Joseph's form on 31 states with the rows that it used."""
    engine = Engine(params(world))
    now = int(world.stamps[615])
    run(engine, [e for e in sensors(world) if e.stamp_ns <= now])
    f = engine.fusion.filter
    before, e = joined(f), f.state.model[fs.MEAN].copy()
    if kind == 'dvl':
        ping = world.dvl()[0]
        event = dataclasses.replace(ping, stamp_ns=now, v_m=f.state.C_b_G.T @ f.state.v_G + 0.01)
    elif kind == 'depth':
        depth = world.depth(every=615)[0]
        event = dataclasses.replace(depth, depth=depth.depth + 0.1)
    else:
        event = world.fixes(100.0, 1.0, rng=np.random.default_rng(0), first_s=5.15)[0]
    list(engine.process(event))
    m = 1 if kind == 'depth' else 3
    H = np.hstack([f.work.H[:m], np.zeros((m, 7))])
    R, z = f.work.R[:m, :m], f.work.z[:m]
    K = np.linalg.solve(H @ before @ H.T + R, H @ before).T
    A = np.eye(31) - K @ H
    expected = A @ before @ A.T + K @ R @ K.T
    sigma = np.sqrt(np.diagonal(before))
    sigma[sigma == 0.0] = 1.0
    assert np.abs((joined(f) - expected) / np.outer(sigma, sigma)).max() < 1e-9
    moved = e - f.state.model[fs.MEAN]
    np.testing.assert_allclose(moved, (K @ z)[24:], atol=1e-9 * sigma[24:].min())
    assert np.abs(moved).max() > 1e-8


def test_thrust_counts_from_its_stamp_on(world):
    """Twice the thrust for the second half of a step is one and a half of it for all of it."""
    p = params(world, filter_period_s=0.1)
    force = np.array([80.0, 0.0, 0.0])
    speeds = []
    for samples in (
        [(100, 1.0), (125, 2.0), (130, 1.0)],
        [(100, 1.0), (120, 1.5), (130, 1.0)],
    ):
        controls = [
            ControlSample(int(world.stamps[k]), i, n * force, np.zeros(3))
            for i, (k, n) in enumerate(samples)
        ]
        engine = Engine(p)
        run(engine, [*[e for e in world.imu() if e.stamp_ns <= world.stamps[130]], *controls])
        speeds.append(engine.fusion.filter.state.model[fs.MEAN, 0])
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-12)


def test_a_thrust_of_before_the_start_still_holds(world):
    early = ControlSample(int(world.stamps[0]), 0, np.array([60.0, 0.0, 0.0]), np.zeros(3))
    engine = Engine(params(world))
    run(engine, [early, *world.imu()[:200]])
    block = engine.fusion.filter.state.model
    assert block[fs.THRUST, 0] == 60.0
    assert engine.fusion.filter.state.counters[fs.THRUST_NS] == early.stamp_ns


def test_an_unknown_thrust_leaves_the_velocity_through_the_water_open(world):
    sigmas = {}
    for name, controls in (('known', thrust(world)), ('unknown', [])):
        engine = Engine(params(world))
        run(engine, [*world.imu(), *controls])
        block = engine.fusion.filter.state.model
        # What is left of v_r when V_c is known
        P = block[fs.P_EE : fs.MEAN]
        current = P[3:5, 3:5]
        left = P[0, 0] - P[0, 3:5] @ np.linalg.solve(current, P[3:5, 0])
        sigmas[name] = np.sqrt(left)
    assert sigmas['unknown'] > sigmas['known']
    assert engine.divergence == ''


def test_a_thrust_that_is_not_finite_gets_a_receipt(world):
    bad = ControlSample(int(world.stamps[300]), 7, np.array([np.nan, 0.0, 0.0]), np.zeros(3))
    out = run(Engine(params(world)), [*world.imu(), bad])
    receipt = next(o for o in out if isinstance(o, Receipt))
    assert (receipt.verdict, receipt.topic, receipt.sequence) == (
        Verdict.NOT_FINITE,
        'control/thrust',
        7,
    )


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'configuration': 'custom', 'delay_handling': 'clone'}, ('delay_handling', 'clone')),
        (
            {'configuration': 'custom', 'noise_adaptation': 'sage_husa'},
            ('noise_adaptation', 'sage_husa'),
        ),
        (
            {'configuration': 'modified_akf_published'},
            ('noise_adaptation', 'sage_husa_published'),
        ),
        ({'model_drag_linear': (9000.0, 90.0, 90.0)}, ('filter_period_s', '0.1 s', 'model_')),
    ],
)
def test_what_cannot_go_along_is_refused_by_name(changes, words):
    with pytest.raises(ConfigError) as error:
        EngineParams(model_aiding=True, **changes)
    for word in words:
        assert word in str(error.value)


# -- the same bits each way -----------------------------------------------------------------------


@pytest.mark.parametrize('noise', ['none', 'adaptive_r'])
@pytest.mark.parametrize('name', AIDED)
def test_a_run_from_arrays_gives_the_bits_of_event_by_event(world, name, noise):
    rng = np.random.default_rng(5)
    x = inputs_with_thrust(world, world.fixes(0.7, lambda _: rng.uniform(0.0, 3.0), rng=rng))
    x.dvl_valid[15:32] = False
    x.dvl_v_m[34] += 1.0
    x.control_force_b[40, 1] = np.inf
    p = params(world, name, noise_adaptation=noise, robust_fixes='huber')
    fast, slow = engine_run.run(p, x), engine_run.run(p, x, one_by_one=True)
    for field in engine_run.Track.__dataclass_fields__:
        np.testing.assert_array_equal(
            getattr(fast.track, field), getattr(slow.track, field), field
        )
    assert repr(fast.receipts) == repr(slow.receipts)
    assert fast.track.model.shape == (121, 31)
    assert {0.0, 1.0} == set(fast.track.model[:, -1])


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32))
def test_rewind_equals_in_order_processing_to_the_bit(world, seed):
    """Random delays, outliers, thrust at odd times, pings lost and found."""
    rng = np.random.default_rng(seed)
    fixes = []
    for f in world.fixes(0.7, 0.0, rng=rng):
        delay_ns = int(rng.uniform(0.0, 6.0) * 1e9)
        outlier = 50.0 if rng.random() < 0.1 else 0.0
        late = dataclasses.replace(f, receive_ns=f.validity_ns + delay_ns, r_e=f.r_e + outlier)
        if late.receive_ns < world.stamps[-1]:
            fixes.append(late)
    lost = rng.uniform(1.0, 5.0), rng.uniform(5.0, 9.0)
    events = []
    for e in sensors(world):
        t = (e.stamp_ns - world.stamps[0]) * 1e-9
        if isinstance(e, DvlPing) and lost[0] < t < lost[1]:
            continue
        if isinstance(e, ControlSample):
            e = dataclasses.replace(e, stamp_ns=e.stamp_ns + int(rng.integers(0, 9_999_999)))
        events.append(e)
    on_time = [dataclasses.replace(f, receive_ns=f.validity_ns) for f in fixes]
    engine, other = Engine(params(world, 'rewind')), Engine(params(world, 'ignore'))
    a, b = last(run(engine, events + fixes)), last(run(other, events + on_time))
    for name in ('r_e', 'v_G', 'C_b_G', 'P', 'gyro_bias_b'):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
    blocks = [e.fusion.filter.state.model.tobytes() for e in (engine, other)]
    assert blocks[0] == blocks[1]
    assert repr(a.model) == repr(b.model)


@pytest.mark.parametrize('counted', [False, True])
def test_a_thrust_commutes_with_a_fix(world, monkeypatch, counted):
    """So `rewind` need not go back for a fix that only a newer thrust makes late."""
    stored = Rewind.stored

    def with_thrust(self):
        past, s = stored(self), self.filter.streams
        cursors = [
            c._replace(stamps=s.control_stamps) if c.rank is Rank.CONTROL else c
            for c in past.cursors
        ]
        return past._replace(cursors=tuple(cursors))

    if counted:
        monkeypatch.setattr(Rewind, 'stored', with_thrust)
    now_ns = int(world.stamps[730])
    noted = dataclasses.replace(
        world.fixes(0.7, 0.0, rng=np.random.default_rng(2))[3], validity_ns=now_ns + 2_000_000
    )
    between = ControlSample(now_ns + 4_000_000, 99_999, np.array([90.0, 0.0, 0.0]), np.zeros(3))
    ends = []
    for after_ns in (1_000_000, 6_000_000):  # received before the thrust, and after it
        fix = dataclasses.replace(noted, receive_ns=noted.validity_ns + after_ns)
        engine = Engine(params(world, 'rewind', gate_probability=1.0))
        out = run(engine, [*sensors(world), between, fix])
        (receipt,) = (o for o in out if isinstance(o, Receipt))
        assert receipt.verdict is Verdict.FUSED
        assert (receipt.steps_rolled_back > 0) == (counted and after_ns == 6_000_000)
        ends.append((last(out), engine.fusion.filter.state.model.tobytes()))
    (a, model), (b, other) = ends
    assert model == other
    for name in ('r_e', 'v_G', 'C_b_G', 'P', 'gyro_bias_b'):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name


# -- bottom lock ----------------------------------------------------------------------------------


def lock_run(world, pings):
    """Estimates every 0.1 s of a run with these pings."""
    events = [*world.imu(), *thrust(world), *world.depth(), *pings]
    return [o for o in run(Engine(params(world)), events) if isinstance(o, Estimate)]


def test_a_lost_dvl_is_used_again_after_three_good_pings(world):
    """Pings at 5 Hz, none from 4 to 7 s: lost at 5.5 s, back with the third, at 7.4 s."""
    pings = [p for p in world.dvl() if not 4.05e9 < p.stamp_ns - world.stamps[0] < 6.95e9]
    out = lock_run(world, pings)
    t = np.array([(e.stamp_ns - world.stamps[0]) * 1e-9 for e in out])
    locked = np.array([e.model.bottom_lock for e in out])
    lost = t[~locked]
    assert lost[0] == pytest.approx(5.6, abs=0.11)
    assert lost[-1] == pytest.approx(7.3, abs=0.11)
    assert np.diff(lost).max() < 0.11
    used = sum(e.local_statistics[0, 0] for e in out)
    waited = sum(e.local_statistics[0, 1] for e in out)
    assert (used, waited) == (len(pings) - 2, 2)


def test_the_engine_says_what_stands_in_for_what(world):
    events = [*world.imu(), *thrust(world), *world.dvl()]
    told = {}
    for name, until_s, controls in (
        ('all', 3.9, True),
        ('no_dvl', 12.0, True),
        ('no_thrust', 3.9, False),
    ):
        engine = Engine(params(world))
        end = world.stamps[0] + int(until_s * 1e9)
        run(
            engine,
            [
                e
                for e in events
                if e.stamp_ns <= end
                and (controls or not isinstance(e, ControlSample))
                and not (isinstance(e, DvlPing) and e.stamp_ns - world.stamps[0] > 4e9)
            ],
        )
        f = engine.aided
        told[name] = engine.aiding_warning, f.has_bottom_lock, f.knows_thrust
    assert told['all'] == ('', True, True)
    assert 'no bottom lock for 8 s' in told['no_dvl'][0]
    assert told['no_dvl'][1:] == (False, True)
    assert 'control/thrust' in told['no_thrust'][0]
    off = Engine(world.params())
    run(off, world.imu()[:5])
    assert (off.aiding_warning, off.aided) == ('', None)


def test_the_covariance_has_no_jump_when_lock_is_lost(world):
    """Without pings it grows by process noise only, and never shrinks by a switch."""
    pings = [p for p in world.dvl() if p.stamp_ns - world.stamps[0] < 4.05e9]
    sigma = np.array([np.sqrt(np.trace(e.P[3:6, 3:6])) for e in lock_run(world, pings)])
    after = sigma[42:]
    steps = np.abs(np.diff(after)) / after[:-1]
    assert steps.max() < 0.1


def test_a_bad_ping_begins_the_count_anew(world):
    pings = [p for p in world.dvl() if not 4.05e9 < p.stamp_ns - world.stamps[0] < 6.95e9]
    again = next(i for i, p in enumerate(pings) if p.stamp_ns - world.stamps[0] > 6e9)
    pings[again + 2] = dataclasses.replace(pings[again + 2], v_m=pings[again + 2].v_m + 5.0)
    out = lock_run(world, pings)
    waited = sum(e.local_statistics[0, 1] for e in out)
    assert waited == 5  # two good, the bad one, two good; the third is used


def test_gated_pings_lose_the_lock_as_missing_ones_do(world):
    pings = [
        dataclasses.replace(p, v_m=p.v_m + 5.0)
        if 4.05e9 < p.stamp_ns - world.stamps[0] < 6.95e9
        else p
        for p in world.dvl()
    ]
    out = lock_run(world, pings)
    locked = [e.model.bottom_lock for e in out]
    assert locked[20]
    assert not locked[65]
    assert locked[-1]
