"""A state that is saved, and a navigation that goes on from it."""

import dataclasses
import hashlib
import struct

import numpy as np
import pytest
import station_twin as twin
from closed_loop import World, inputs_of

from polar_nav_core import attitude
from polar_nav_core.engine import away
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind, DvlPing, Fix, ImuSample
from polar_nav_core.engine.first_seconds import FirstSeconds
from polar_nav_core.engine.health.conditions import Level
from polar_nav_core.engine.ledger import Believed
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.restart import age_problem, saved_problem
from polar_nav_core.engine.saved import SavedStateError, pack, unpack
from polar_nav_core.engine.sins.filter import NavigationFilter
from polar_nav_core.engine.sins.leader import LeaderError, heard_problem
from polar_nav_core.engine.sins.turned import free_since_ns
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.station import state as ss

CUT_S, AWAY_S = 40.0, 5.0
HEAD = struct.calcsize('<8sH32sQ')


@pytest.fixture(scope='module')
def world():
    return World(60.0)


@pytest.fixture(scope='module')
def events(world):
    fixes = world.fixes(1.0, 1.5, rng=np.random.default_rng(3))
    return list(inputs_of(world, fixes).events())


def drive(engine, events):
    return [output for event in events for output in engine.process(event)]


def cut(events, away_s=AWAY_S, at_s=CUT_S):
    """Events before a node was ended, and those after it was started again."""
    begin_ns = events[0].stamp_ns
    cut_ns, again_ns = begin_ns + round(at_s * 1e9), begin_ns + round((at_s + away_s) * 1e9)
    return (
        [e for e in events if e.stamp_ns < cut_ns],
        [e for e in events if e.stamp_ns >= again_ns],
    )


def restore(saved, stamp_ns):
    return Command(stamp_ns, -1, CommandKind.RESTORE, saved, 'nav/restore')


def restarted(params, saved, after):
    """Outputs of a new engine that gets the saved state with its first sample."""
    engine = Engine(params)
    first_ns = next(e.stamp_ns for e in after if isinstance(e, ImuSample))
    events = sorted([*after, restore(saved, first_ns)], key=lambda e: e.key)
    return engine, drive(engine, events)


@pytest.fixture(scope='module')
def saved(world, events):
    engine = Engine(world.params(configuration='default'))
    drive(engine, cut(events)[0])
    return engine.saved()


def test_bytes_give_the_same_state(saved):
    again = unpack(pack(saved))
    assert again.values.keys() == saved.values.keys()
    assert all(np.array_equal(again.values[n], saved.values[n]) for n in saved.values)
    rest = dataclasses.replace(again, values=saved.values)
    assert rest == saved


@pytest.mark.parametrize(
    ('damage', 'words'),
    [
        (lambda d: d[:20], 'too few'),
        (lambda d: b'X' + d[1:], 'no saved state'),
        (lambda d: d[:8] + struct.pack('<H', 8) + d[10:], 'format 8 .* up to 7'),
        (lambda d: d[:-1], 'damaged'),
        (lambda d: d[:200] + bytes([d[200] ^ 1]) + d[201:], 'damaged'),
        (lambda d: d + b'0', 'damaged'),
    ],
)
def test_damaged_bytes_are_refused_with_a_sentence(saved, damage, words):
    with pytest.raises(SavedStateError, match=words):
        unpack(damage(pack(saved)))


@pytest.mark.parametrize(
    ('was', 'now'),
    [
        (b'"fixes": [', b'"fixes": [Infinity, '),
        (b'"fixes": [', b'"fixes": [-'),
        (b'"fixes": [', b'"fixes": [1' + b'0' * 30),
        (b'"stamp_ns": ', b'"stamp_ns": -Infinity, "was": '),
        (b'"lost_heading": null', b'"lost_heading": [1]'),
        (b'"lost_heading": null', b'"lost_heading": [-1, false]'),
        (b'"followed": null', b'"followed": [NaN, 0.0, true]'),
        (b'"followed": null', b'"followed": [1e300, 0.0, true]'),
        (b'"followed": null', b'"followed": [1.0]'),
        (b'"shapes": ', b'"shapes": ' + b'[' * 100_000),
    ],
)
def test_a_right_checksum_of_odd_numbers_is_refused_with_a_sentence(saved, was, now):
    body = pack(saved)[HEAD:]
    (length,) = struct.unpack_from('<I', body)
    text = body[4 : 4 + length].replace(was, now)
    body = struct.pack('<I', len(text)) + text + body[4 + length :]
    data = struct.pack('<8sH32sQ', b'POLARNAV', 5, hashlib.sha256(body).digest(), len(body)) + body
    with pytest.raises(SavedStateError, match='makes no sense'):
        unpack(data)


@pytest.mark.parametrize('measured', [False, True])
def test_a_heading_that_nothing_has_measured_is_an_error_after_a_restart_too(
    world, events, measured
):
    """Fixes have begun the navigation anew; of a DVL that was used before, nothing follows."""
    before, after = cut(events)
    engine = Engine(world.params(configuration='default'))
    drive(engine, before)
    now_ns = engine.fusion.stamp_ns
    anew_ns = now_ns - 10**9 if measured else now_ns  # the newest ping came between
    engine.ledger.believed(anew_ns, how=Believed.ANEW)
    saved = unpack(pack(engine.saved()))
    assert saved.lost_heading == (anew_ns, measured)
    without = [e for e in after if not isinstance(e, DvlPing)]
    again, _ = restarted(world.params(configuration='default'), saved, without)
    found = {p.condition.key: p.condition for p in again.look().present}
    if measured:
        assert 'heading unknown' not in found
        return
    assert found['heading unknown'].level is Level.ERROR
    since_s = (again.fusion.stamp_ns - anew_ns) * 1e-9
    assert f'began anew {since_s:.0f} s ago: no DVL' in found['heading unknown'].sentence
    shown, _ = restarted(world.params(configuration='default'), saved, after)
    assert 'heading unknown' not in {p.condition.key for p in shown.look().present}
    reset = dataclasses.replace(saved, lost_heading=None)  # and of an older file
    older, _ = restarted(world.params(configuration='default'), reset, without)
    assert 'heading unknown' not in {p.condition.key for p in older.look().present}


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'layout': 'station 12'}, 'of a filter station 12'),
        ({'latitude': 9.0}, 'latitude'),
        ({'records': (b'1', b'')}, 'length'),
        ({'P': -np.eye(24)}, 'positive definite'),
        ({'P': np.full((24, 24), np.nan)}, 'not finite'),
        ({'P': np.eye(23)}, 'other shapes of P'),
        ({'C_b_G': 2.0 * np.eye(3)}, 'rotation'),
        ({'leader': np.full(28, -1.0)}, 'leader'),
        ({'r_e': np.zeros(3)}, 'two positions'),
        ({'v_G': np.full(3, 1e300)}, 'two velocities'),
        ({'turn': np.array([1e300])}, 'turn of the state is beyond'),
        ({'b_gyro_b': np.full(3, -2.0)}, 'b_gyro_b of the state is beyond'),
    ],
)
def test_what_no_filter_can_start_from_is_refused(world, events, saved, change, words):
    name = next(iter(change))
    if name in saved.values:
        bad = dataclasses.replace(saved, values={**saved.values, **change})
    else:
        bad = dataclasses.replace(saved, **change)
    params = world.params(configuration='default')
    assert words in saved_problem(params, bad)
    _, out = restarted(params, bad, cut(events)[1][:10])
    refused = [o for o in out if isinstance(o, Receipt)]
    assert [r.verdict for r in refused] == [Verdict.IMPLAUSIBLE]
    assert words in refused[0].reason


def as_format(version, saved, *without):
    """Bytes of a state as an older format had it."""
    shorter = {'leader': slice(27 if version < 5 else 28)} if version < 7 else {}
    if version < 3:
        shorter = {'sensitivity': (slice(None), slice(12)), 'leader': slice(20)}
    values = {
        n: v[shorter[n]] if n in shorter else v
        for n, v in saved.values.items()
        if n not in without
    }
    data = pack(dataclasses.replace(saved, values=values))
    return data[:8] + struct.pack('<H', version) + data[10:]


@pytest.mark.parametrize(
    ('version', 'without'),
    [
        (1, ['leader', 'wander', 'used', 'free']),
        (2, ['wander', 'used', 'free']),
        (4, ['free']),
        (5, ['free']),
        (6, []),
    ],
)
def test_a_state_of_an_older_format_is_read(world, events, saved, version, without):
    older = unpack(as_format(version, saved, *without))
    assert older.version == version
    params = world.params(configuration='default')
    assert saved_problem(params, older) == ''
    after = cut(events)[1]
    same = dataclasses.replace(saved, version=version)
    outputs = [restarted(params, one, after)[1] for one in (older, same)]
    estimates = [[o for o in out if isinstance(o, Estimate)] for out in outputs]
    assert len(estimates[0]) > 50
    # As recordings of format 1 and 2 have it: at the first sample.
    first = next(e for e in after if isinstance(e, ImuSample))
    at_once = estimates[0][0].stamp_ns - first.stamp_ns <= 100_000_000
    assert at_once is (version < 3)
    # This world's leader states nothing of its own error.
    assert all(
        np.array_equal(a.r_e, b.r_e) and np.array_equal(a.P, b.P)
        for a, b in zip(*estimates, strict=True)
    )


def test_a_state_of_engine_3_is_refused_with_both_versions(world, saved):
    """It has no rate of turn, which the growth of the covariance over the time away needs."""
    oldest = unpack(as_format(1, saved, 'leader', 'wander', 'turn', 'used', 'free'))
    problem = saved_problem(world.params(configuration='default'), oldest)
    assert 'format 1 and engine 3, this is format 7 and engine' in problem


def leader_fixes(count, begin_ns):
    """Fixes of a leader that goes 1 m/s north and states what it knows of itself."""
    draw = np.random.default_rng(5)
    start_e = np.array([0.0, 0.0, 6.357e6])
    for k in range(count):
        way_e = np.array([0.0, 2.0 * k, 0.0])
        relative_e = np.array([100.0, 0.0, 0.0])
        sigma = 1.0 + 0.06 * (k // 4)
        yield Fix(
            validity_ns=begin_ns + k * 2 * 10**9,
            transmit_ns=0,
            receive_ns=begin_ns + k * 2 * 10**9 + 10**9,
            source='leader',
            sequence=k,
            order=k,
            arrival=k,
            r_e=start_e + way_e + relative_e + draw.normal(size=3),
            covariance_e=np.eye(3) * (1.0 + sigma**2),
            relative_e=relative_e,
            leader_sigma=sigma,
            leader_heading_sigma=0.01,
        )


@pytest.mark.parametrize('heard', [0, 1, 30])
def test_what_was_heard_of_a_leader_is_known_again(heard):
    fixes = list(leader_fixes(60, 1_772_323_200 * 10**9))
    whole = LeaderError(600.0)
    for fix in fixes[:heard]:
        whole.split(fix)
    values = whole.packed()
    assert np.isfinite(values).all()
    assert heard_problem(values) == ''
    again = LeaderError(600.0)
    again.unpack(values)
    assert again.stated is (heard > 0)
    for fix in fixes[heard:]:
        expected, found = whole.split(fix), again.split(fix)
        # A double has room for a stamp to 256 ns.
        np.testing.assert_allclose(found.common_e, expected.common_e, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.covariance_e, expected.covariance_e, rtol=1e-6)


def test_age(saved):
    second = 10**9
    assert age_problem(saved, saved.stamp_ns + 5 * second, 60.0) == ''
    assert '61.0 s old' in age_problem(saved, saved.stamp_ns + 61 * second, 60.0)
    assert 'newer' in age_problem(saved, saved.stamp_ns - second, 60.0)


@pytest.mark.parametrize('configuration', ['default', 'modified_akf', 'conventional_akf'])
@pytest.mark.parametrize('away_s', [0.0, AWAY_S])
def test_navigation_goes_on(world, events, configuration, away_s):
    """Straight way: the estimates are those of a run without a break but for some decimetres."""
    params = world.params(configuration=configuration)
    before, after = cut(events, away_s)
    first = Engine(params)
    drive(first, before)
    engine, out = restarted(params, first.saved(), after)
    index = {int(s): k for k, s in enumerate(world.stamps)}
    estimates = [o for o in out if isinstance(o, Estimate)]
    assert 2.0 <= (estimates[0].stamp_ns - after[0].stamp_ns) * 1e-9 <= 2.2
    errors, nees = [], []
    for e in estimates:
        off_e = e.r_e - world.r_e[index[e.stamp_ns]]
        errors.append(float(np.linalg.norm(off_e)))
        nees.append(float(off_e @ np.linalg.solve(e.P[6:9, 6:9], off_e)))
    delayed = 5.0 if configuration == 'conventional_akf' else 0.0
    assert max(errors) < 1.5 + delayed
    if not delayed:
        assert max(nees) < 21.1  # chi-square (3), 99.99 %
    assert engine.fix_counts()[0] > first.fix_counts()[0]


def test_a_sensor_that_is_silent_since_a_restart_is_missed(world, events, saved):
    """A node that was started again, and that only the IMU reaches."""
    params = world.params(configuration='default', sensor_silent_s=5.0, max_gated_s=10.0)
    imu = [e for e in cut(events)[1] if isinstance(e, ImuSample)]
    engine, _ = restarted(params, saved, imu)
    said = [p.condition.sentence for p in engine.health.present]
    away_s = (engine.last_imu_ns - saved.stamp_ns) * 1e-9
    assert away_s > 15.0
    assert f'no DVL used for {away_s:.0f} s' in said
    assert f'no depth used for {away_s:.0f} s' in said
    assert engine.integrity.level is engine.integrity.level.WARN
    assert 'dead reckoning' in engine.integrity.sentence
    # Of an older state nobody knows.
    older = unpack(as_format(3, saved, 'used', 'free'))
    assert saved_problem(params, older) == ''
    said = [p.condition.sentence for p in restarted(params, older, imu)[0].health.present]
    assert not any(sentence.startswith(('no DVL', 'no depth')) for sentence in said)


@pytest.fixture(scope='module')
def turning_world():
    """A leg of 25 s, a half turn of 30 s at 6 deg/s, and the next leg."""
    return World(110.0, leg_s=25.0)


def turned(saved, angle, free_for_s):
    """A state whose attitude and velocity have been turned about up since [rad]."""
    R = attitude.exp(np.array([0.0, 0.0, angle]))
    v_G = R @ saved.values['v_G']
    values = {
        **saved.values,
        'C_b_G': R @ saved.values['C_b_G'],
        'v_G': v_G,
        'free': np.array([free_for_s]),
    }
    return unpack(pack(dataclasses.replace(saved, v_G=tuple(v_G.tolist()), values=values)))


@pytest.mark.slow
@pytest.mark.parametrize(('free_for_s', 'found'), [(590.0, True), (0.0, False)])
def test_a_heading_that_may_be_any_still_may_after_a_restart(turning_world, free_for_s, found):
    """Pings go along with a turn by 100 deg that never was: fixes show it, if it is possible."""
    world = turning_world
    params = world.params(configuration='default')
    fixes = world.fixes(1.0, 1.5, rng=np.random.default_rng(9972))
    before, after = cut(list(inputs_of(world, fixes, 9972).events()), 2.0, 20.0)
    first = Engine(params)
    drive(first, before)
    saved = turned(first.saved(), np.deg2rad(100.0), free_for_s)
    after = cut(after, 0.0, 22.0)[0]
    last = [o for o in restarted(params, saved, after)[1] if isinstance(o, Estimate)][-1]
    true = world.C_b_G[list(world.stamps).index(last.stamp_ns)]
    off = abs(np.rad2deg(attitude.log(last.C_b_G @ true.T)[2]))
    assert off < 5.0 if found else off > 30.0


def test_a_ping_that_leapt_before_a_restart_is_remembered(world, events):
    params = world.params(configuration='default')
    before, after = cut(events)
    engine = Engine(params)
    drive(engine, before)
    assert engine.saved().values['free'] == 0.0
    leapt_ns = engine.last_imu_ns - 7_000_000_000
    engine.fusion.filter.state.counters[fs.LEAPT_NS] = leapt_ns
    saved = unpack(pack(engine.saved()))
    assert saved.values['free'] == pytest.approx(593.0)
    again, _ = restarted(params, saved, after[:1000])
    assert free_since_ns(again.fusion.filter) == leapt_ns
    said = [p.condition for p in again.health.present if p.condition.key == 'DVL leapt']
    assert [c.level for c in said] == [Level.ERROR]
    beyond = dataclasses.replace(saved, values={**saved.values, 'free': np.array([601.0])})
    assert 'free of the state is beyond 600' in saved_problem(params, beyond)


@pytest.mark.slow
@pytest.mark.parametrize('configuration', ['default', 'modified_akf'])
@pytest.mark.parametrize(
    ('at_s', 'away_s', 'first_within'),
    [
        pytest.param(30.0, 8.0, True, id='in a turn'),
        pytest.param(23.0, 4.5, True, id='it begins'),
        pytest.param(51.0, 3.0, True, id='it begins while pings are watched'),
        # At which time of so many seconds it ended is not known.
        pytest.param(50.0, 8.0, False, id='it ends'),
    ],
)
def test_a_turn_while_away_heals(turning_world, configuration, at_s, away_s, first_within):
    """A turn of 15 to 48 deg: stated at once, and found again within a minute."""
    world = turning_world
    params = world.params(configuration=configuration)
    fixes = world.fixes(1.0, 1.5, rng=np.random.default_rng(9971))
    before, after = cut(list(inputs_of(world, fixes, 9971).events()), away_s, at_s)
    first = Engine(params)
    drive(first, before)
    _, out = restarted(params, first.saved(), after)
    index = {int(s): k for k, s in enumerate(world.stamps)}
    estimates = [o for o in out if isinstance(o, Estimate)]
    errors, nees = [], []
    for e in estimates:
        off_e = e.r_e - world.r_e[index[e.stamp_ns]]
        errors.append(float(np.linalg.norm(off_e)))
        nees.append(float(off_e @ np.linalg.solve(e.P[6:9, 6:9], off_e)))
    limit = 1.0 + 0.02 * 2.83 * away_s
    assert errors[0] < limit or not first_within
    assert nees[0] < 16.3  # chi-square (3), 99.9 %
    assert max(nees) < 21.1  # 99.99 %
    late = len(errors) - 100  # the last ten seconds
    assert max(errors[late:]) < limit
    begun, ended = estimates[0], estimates[-1]
    off = [attitude.log(world.C_b_G[index[e.stamp_ns]] @ e.C_b_G.T)[2] for e in (begun, ended)]
    assert abs(off[0]) < 3.3 * np.sqrt(begun.P[2, 2])
    assert abs(off[1]) < np.deg2rad(2.0)


@pytest.mark.slow
@pytest.mark.parametrize('configuration', ['default', 'modified_akf'])
def test_a_turn_that_began_and_ended_unseen_heals(configuration):
    """Of 6 deg in 8 s: without the room for it the filter is sure of a wrong heading for good."""
    world = World(82.0, leg_s=41.0, turn_s=1.0)
    params = world.params(configuration=configuration)
    fixes = world.fixes(1.0, 1.5, rng=np.random.default_rng(9972))
    before, after = cut(list(inputs_of(world, fixes, 9972).events()), 8.0, 40.0)
    first = Engine(params)
    drive(first, before)
    _, out = restarted(params, first.saved(), after)
    index = {int(s): k for k, s in enumerate(world.stamps)}
    late_ns = after[0].stamp_ns + 28_000_000_000
    late = [o for o in out if isinstance(o, Estimate) and o.stamp_ns > late_ns]
    off = [float(np.linalg.norm(e.r_e - world.r_e[index[e.stamp_ns]])) for e in late]
    assert len(off) > 50
    assert max(off) < 1.5
    last = late[-1]
    turned = attitude.log(world.C_b_G[index[last.stamp_ns]] @ last.C_b_G.T)[2]
    assert abs(turned) < np.deg2rad(2.0)


@pytest.mark.parametrize('change', [0.0, 0.5])
def test_pings_of_the_first_seconds_show_speed_and_course(world, events, saved, change):
    """Uniform motion, and pings of a vehicle that is faster since."""
    params = world.params(configuration='default')
    first = FirstSeconds(params, saved)
    began_ns = None
    for event in cut(events)[1]:
        if isinstance(event, DvlPing):
            faster = event.v_m * (1.0 + change / np.linalg.norm(event.v_m))
            first.ping(dataclasses.replace(event, v_m=faster))
        if isinstance(event, ImuSample):
            began_ns = event.stamp_ns if began_ns is None else began_ns
            if first.imu(event):
                break
    seen = first.seen(event.stamp_ns)
    assert seen.begin_ns == began_ns
    assert seen.watched_s == pytest.approx(2.0, abs=0.2)
    speed = np.hypot(*world.v_G[0][:2]) + change
    assert seen.speed == pytest.approx(speed, abs=0.02)
    assert seen.path == pytest.approx([speed * seen.watched_s, 0.0], abs=0.05)
    assert seen.up == pytest.approx(0.0, abs=0.02)
    assert seen.rate == pytest.approx(0.0, abs=0.005)
    index = {int(s): k for k, s in enumerate(world.stamps)}[event.stamp_ns]
    course = np.arctan2(world.v_G[index][1], world.v_G[index][0])
    off = attitude.log(away.about_up(course) @ seen.C_b_c @ world.C_b_G[index].T)
    assert np.abs(off).max() < 0.01
    # It begins with a speed that may be the one that was seen.
    dv = np.sqrt(begun_with(params, saved, seen, event.stamp_ns)[3:6])
    assert dv.max() > 0.9 * change
    assert dv.max() < 0.1 or change


def begun_with(params, saved, seen, stamp_ns):
    """Variances with which a filter begins."""
    initial = dataclasses.replace(saved, seen=seen)
    return np.diag(NavigationFilter(params, initial, stamp_ns).state.P)


@pytest.mark.parametrize(
    ('kept', 'waited_s'),
    [
        pytest.param(0, 1.0, id='no DVL'),
        pytest.param(3, 4.0, id='a DVL that ends'),
    ],
)
def test_too_few_pings_show_nothing(world, events, saved, kept, waited_s):
    """It begins all the same, as uncertain as any vehicle that nobody saw."""
    pings = [e for e in cut(events)[1] if isinstance(e, DvlPing)]
    unused = {id(p) for k, p in enumerate(pings) if k >= kept}
    after = [e for e in cut(events)[1] if id(e) not in unused]
    params = world.params(configuration='default')
    _, out = restarted(params, saved, after)
    first = next(o for o in out if isinstance(o, Estimate))
    begin_ns = next(e.stamp_ns for e in after if isinstance(e, ImuSample))
    waited_ns = first.stamp_ns - begin_ns
    assert waited_ns * 1e-9 == pytest.approx(waited_s, abs=0.1)
    assert first.P[2, 2] > (away.TURN_RATE * AWAY_S) ** 2


def track(rate, speed=2.0, jump=0.0):
    """Times and velocities of 2 s of a turn, whose estimate is corrected by an angle after 1 s."""
    time_s = 0.01 * np.arange(201)
    angle = 1.0 + rate * time_s + jump * (time_s >= 1.0)
    rise = np.full(201, 0.1)
    return time_s, np.stack([speed * np.cos(angle), speed * np.sin(angle), rise], axis=1)


def test_the_rate_of_turn_is_that_of_the_track():
    assert away.turn_rate(*track(0.05)) == pytest.approx(0.05)
    assert away.turn_rate(*track(-0.05)) == pytest.approx(-0.05)
    assert away.turn_rate(*track(0.05, speed=0.29)) == 0.0
    assert away.turn_rate(*track(0.4)) == 0.3
    time_s, v_G = track(0.05)
    assert away.turn_rate(time_s[:1], v_G[:1]) == 0.0
    assert away.turn_rate(time_s[:0], v_G[:0]) == 0.0


@pytest.mark.parametrize('jump', [0.05, -3.0])
def test_a_correction_of_the_heading_is_no_turn(jump):
    assert away.turn_rate(*track(0.05, jump=jump)) == pytest.approx(0.05)


@pytest.mark.parametrize('configuration', ['default', 'modified_akf'])
def test_a_fix_that_finds_the_heading_leaves_no_turn(world, events, configuration):
    """Saved after each fix that turns the track, whichever epochs it corrects."""
    right = world.params()
    engine = Engine(
        dataclasses.replace(
            right,
            configuration=configuration,
            initial_grid_heading_deg=right.initial_grid_heading_deg + 10.0,
            initial_sigma_heading_deg=10.0,
            initial_sigma_velocity=1.0,
        )
    )
    rates, turned = [], []
    for event in events:
        if event.stamp_ns > events[0].stamp_ns + 15 * 10**9:
            break
        outputs = list(engine.process(event))
        if any(isinstance(o, Receipt) for o in outputs):
            values = engine.saved().values
            rates.append(values['turn'][0])
            turned.append(np.arctan2(values['v_G'][1], values['v_G'][0]))
    assert np.abs(np.diff(turned)).max() > 0.05
    assert np.abs(rates).max() < 0.01


def test_the_wander_of_a_track_is_its_change_from_window_to_window():
    time_s = 0.1 * np.arange(401)
    unknown = np.zeros(2)
    for weave, surge in ((0.0, 0.0), (0.01, 0.02)):
        windows = np.floor((np.arange(401) - 1) / 20.0) % 2.0
        rate, push = weave * (2.0 * windows - 1.0), surge * (2.0 * windows - 1.0)
        angle, speed = 0.1 * np.cumsum(rate), 2.0 + 0.1 * np.cumsum(push)
        v_G = np.stack([speed * np.cos(angle), speed * np.sin(angle), 0.0 * angle], axis=1)
        found = away.wander(time_s, v_G, unknown)
        assert found == pytest.approx([2.0 * weave, surge], rel=0.1, abs=1e-9)
        assert away.wander(time_s[:60], v_G[:60], unknown) is unknown
        assert away.wander(time_s[:0], v_G[:0], unknown) is unknown
    assert away.wander(time_s, 0.1 * v_G, unknown) is unknown


def test_a_bridged_turn_goes_from_one_rate_to_the_other():
    turned, path = away.bridged_turn(0.1, 0.1, 3.0)
    assert np.allclose(turned, away.about_up(0.3))
    assert path[0, :2] == pytest.approx([np.sin(0.3) / 0.1, -(1.0 - np.cos(0.3)) / 0.1], abs=1e-4)
    turned, path = away.bridged_turn(0.0, 0.1, 4.0)
    assert np.allclose(turned, away.about_up(0.2))
    # The angle is 0.0125 t^2, so the way abeam 0.0125 t^3 / 3.
    assert path[1, 0] == pytest.approx(0.2667, abs=2e-3)
    assert path[2, 2] == pytest.approx(4.0)


def test_what_is_not_known_of_a_bridged_turn():
    # A step of 0.1 rad/s at any time of 3 s: an even distribution of 0.3 rad.
    assert away.bridged_variance(0.0, 0.1, 0.0, 3.0) == pytest.approx(0.3**2 / 12.0, rel=1e-3)
    assert away.bridged_variance(0.05, 0.05, 0.0, 10.0) == pytest.approx(0.02**2)
    # The half of two rates that are known to 0.01 rad/s each.
    assert away.bridged_variance(0.0, 0.0, 0.01, 2.0) == pytest.approx(0.0002, rel=1e-2)
    assert away.bridged_variance(-0.3, 0.3, 0.0, 60.0) == away.MOST_TURN**2


def test_a_held_turn_is_an_arc_that_dies_out():
    turned, path = away.held_turn(0.1, 1e-3)
    assert np.allclose(path, 1e-3 * np.eye(3), atol=1e-7)
    turned, path = away.held_turn(0.1, 200.0)
    angle = 0.1 * away.TURN_LASTS_S
    assert turned @ [1.0, 0.0, 2.0] == pytest.approx([np.cos(angle), np.sin(angle), 2.0], abs=1e-4)
    assert np.linalg.det(turned) == pytest.approx(1.0)
    assert path[2] == pytest.approx([0.0, 0.0, 200.0])
    assert np.allclose(away.held_turn(0.0, 5.0)[1], 5.0 * np.eye(3))


def test_an_unknown_turn_goes_with_the_path():
    """Many random walks of heading, each with the path that it leads along."""
    t, variance, v_G = 6.0, 0.04, np.array([2.0, 1.0, 0.0])
    rng = np.random.default_rng(9972)
    steps = rng.normal(0.0, np.sqrt(variance / 200), (20_000, 200))
    heading = np.cumsum(steps, axis=1)
    c, s = np.cos(heading), np.sin(heading)
    track = np.stack([c * v_G[0] - s * v_G[1], s * v_G[0] + c * v_G[1]], axis=2)
    # Estimate minus truth, where the estimate went on straight.
    now = np.column_stack([heading[:, -1], v_G[:2] - track[:, -1], t * (v_G[:2] - track.mean(1))])
    P = np.zeros((9, 9))
    rows = away.Rows(slice(0, 3), slice(3, 6), slice(6, 9))
    away.add_turn(P, rows, np.eye(3), v_G, variance, t)
    kept = [2, 3, 4, 6, 7]
    sampled = now.T @ now / len(now)
    scale = np.sqrt(np.outer(np.diagonal(sampled), np.diagonal(sampled)))
    assert np.abs((P[np.ix_(kept, kept)] - sampled) / scale).max() < 0.06


def test_fixes_of_before_are_still_known(world, events, saved):
    """Every fix that was received before the end is sent again, as it was and renumbered."""
    params = world.params(configuration='default')
    before, after = cut(events)
    old = [e for e in before if e.topic == 'acomms/rx'][-20:]
    now_ns = after[100].stamp_ns
    copies = [
        dataclasses.replace(f, receive_ns=now_ns + k, arrival=900 + k, sequence=f.sequence + n)
        for k, (f, n) in enumerate((f, n) for f in old for n in (0, 1000))
    ]
    sent = sorted([*after[:400], *copies], key=lambda e: e.key)
    _, out = restarted(params, saved, sent)
    verdicts = [o.verdict for o in out if isinstance(o, Receipt) and o.receive_ns >= now_ns]
    assert verdicts.count(Verdict.DUPLICATE) == len(old)
    assert verdicts.count(Verdict.REPLAYED) == len(old)


def test_a_model_that_was_loosened_stays_loose():
    params = twin.params(identify_method='none')
    events = list(twin.inputs(twin.truth(30.0), 1, depth_every=10).events())
    before, after = cut(events, 2.0, 20.0)
    first = Engine(params)
    drive(first, before)
    first.fusion.filter.bank.loose[ss.EXTRA] = 1e-3
    loose = unpack(pack(first.saved()))
    firm = dataclasses.replace(loose, values={**loose.values, 'loose': np.zeros(ss.LOOSE)})
    sigma = {}
    for name, one in (('loose', loose), ('firm', firm)):
        engine, _ = restarted(params, one, after[:20])
        filter_ = engine.fusion.filter
        assert bool(filter_.bank.loose[ss.EXTRA] > 0.0) is (name == 'loose')
        sigma[name] = filter_.bank.P[0, ss.CURRENT, ss.CURRENT]
    assert sigma['loose'] - sigma['firm'] > 0.9 * 2.0 * 1e-3
    wild = dataclasses.replace(loose, values={**loose.values, 'loose': np.full(ss.LOOSE, 1e6)})
    assert 'walks' in saved_problem(params, wild)
    older = unpack(as_format(1, loose, 'loose'))
    assert saved_problem(params, older) == ''
    assert not older.values['loose'].any()


def test_a_bank_of_station_mode_goes_on():
    params = twin.params(identify_method='none')
    events = list(twin.inputs(twin.truth(30.0), 1, depth_every=10).events())
    before, after = cut(events, 2.0, 20.0)
    first = Engine(params)
    drive(first, before)
    saved = unpack(pack(first.saved()))
    assert saved_problem(params, saved) == ''
    assert 'shapes' in saved_problem(
        params, dataclasses.replace(saved, values={**saved.values, 'x': np.zeros((1, 2))})
    )
    _, out = restarted(params, saved, after)
    whole = {e.stamp_ns: e for e in drive(Engine(params), events) if isinstance(e, Estimate)}
    estimates = [o for o in out if isinstance(o, Estimate)]
    assert len(estimates) > 50
    for e in estimates[1:]:  # the first is that of the first sample
        # The run without a break has one fix more.
        difference_e = e.r_e - whole[e.stamp_ns].r_e
        assert difference_e @ np.linalg.solve(e.P[6:9, 6:9], difference_e) < 9.0


@pytest.mark.parametrize('jumped', [False, True])
def test_fixes_that_were_followed_are_a_condition_after_a_restart_too(jumped):
    """Which of the two places is right no restart shows."""
    params = twin.params(identify_method='none')
    events = list(twin.inputs(twin.truth(30.0), 1, depth_every=10).events())
    before, after = cut(events, 2.0, 20.0)
    first = Engine(params)
    drive(first, before)
    counters = first.fusion.filter.bank.counters
    counters[ss.FOLLOWED_MM : ss.FOLLOWED_MM + 2] = 300_000, -400_000
    counters[ss.JUMPED] = jumped
    saved = unpack(pack(first.saved()))
    assert saved.followed == (300.0, -400.0, jumped)
    again, _ = restarted(params, saved, after)
    said = {p.condition.key: p.condition for p in again.look().present}['fixes followed']
    assert said.level is (Level.ERROR if jumped else Level.WARN)
    assert ' 500 m' in said.sentence
    # A file of before says nothing of it.
    text = pack(saved).replace(b'"followed"', b'"unstated"')
    body = text[HEAD:]
    older = unpack(
        struct.pack('<8sH32sQ', b'POLARNAV', 5, hashlib.sha256(body).digest(), len(body)) + body
    )
    assert older.followed is None


@pytest.mark.parametrize('jumped', [False, True])
def test_a_vehicle_with_a_dvl_knows_after_a_restart_which_fixes_it_has_followed(
    world, events, jumped
):
    before, after = cut(events)
    first = Engine(world.params(configuration='default'))
    drive(first, before)
    assert first.saved().followed is None
    first.ledger.integrity.followed.restore((300.0, -400.0, jumped))
    saved = unpack(pack(first.saved()))
    assert saved.followed == (300.0, -400.0, jumped)
    again, _ = restarted(world.params(configuration='default'), saved, after)
    said = {p.condition.key: p.condition for p in again.look().present}['fixes followed']
    assert said.level is (Level.ERROR if jumped else Level.WARN)
    assert ' 500 m' in said.sentence
