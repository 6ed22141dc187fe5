"""Clocks that step: navigation goes on as if they had not, and a replay does the same."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_core.engine.clocks import Clocks
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import ClockStep, DvlPing, Fix, ImuSample, number_of, shifted
from polar_nav_core.engine.imu_clock import Refused
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.reorder import Reorder
from polar_nav_core.engine.verdicts import Verdict

WINDOW_S = 0.05
NS = 10**9
IMU = 'imu/data_raw'


@pytest.fixture(scope='module')
def world():
    return World(12.0)


@pytest.fixture(scope='module')
def events(world):
    """Events in the order of arrival, each at its stamp."""
    rng = np.random.default_rng(5)
    fixes = world.fixes(1.0, 1.7, rng=rng)
    found = [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng), *fixes]
    return sorted(found, key=lambda e: e.key)


@pytest.fixture(scope='module')
def clean(world, events):
    """Outputs of a node whose clocks never step."""
    return live(world, stepped(events, []))[1]


def live(world, messages):
    """Outputs of a node that receives (arrival, event)."""
    driver = Reorder(Engine(world.params(reorder_window_s=WINDOW_S)), WINDOW_S, 0.25)
    out = [o for arrival_ns, event in messages for o in driver.add(event, arrival_ns)]
    return driver.engine, [*out, *driver.flush()]


def stepped(events, steps):
    """Arrivals and events after steps of clocks: (time since the start [s], step [s], topic)."""
    start_ns = events[0].stamp_ns
    out = []
    for event in events:
        since_s = (event.stamp_ns - start_ns) / NS
        by_ns = sum(
            round(by_s * NS)
            for at_s, by_s, topic in steps
            if since_s >= at_s and topic in ('', event.topic)
        )
        out.append((event.stamp_ns, shifted(event, by_ns)))
    return out


def states(out):
    return [(o.stamp_ns, o.r_e.tobytes(), o.P.tobytes()) for o in out if isinstance(o, Estimate)]


def refused(out):
    used = (Verdict.FUSED, Verdict.GATED)
    return [o for o in out if isinstance(o, Receipt) and o.verdict not in used]


def replayed(world, messages, steps, unused):
    """States of a replay: messages topic by topic, recorded steps, without what was refused."""
    engine = Engine(world.params(reorder_window_s=WINDOW_S))
    for step in steps:
        engine.clock.note(step)
    mapped = [shifted(e, engine.clock.offset_ns(e.topic, number_of(e))) for _, e in messages]
    numbers = {(r.topic, r.sequence) for r in unused}
    mapped = [e for e in mapped if (e.topic, e.sequence) not in numbers]
    out = [o for e in sorted(mapped, key=lambda e: e.key) for o in engine.process(e)]
    return states([*out, *engine.finish()])


STEPS = st.lists(
    st.tuples(
        st.floats(3.0, 11.0),
        st.one_of(st.floats(-8.0, -0.7), st.floats(0.7, 8.0), st.sampled_from([3.6e3, -1e5, 4e8])),
        st.sampled_from(['', '', IMU, 'dvl/data', 'depth/data']),
    ),
    max_size=4,
)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(STEPS)
def test_no_sequence_of_steps_ends_navigation_and_a_replay_does_the_same(
    world, events, clean, steps
):
    messages = stepped(events, steps)
    engine, out = live(world, messages)
    found = [o for o in out if isinstance(o, ClockStep)]
    assert len(states(out)) >= len(states(clean)) - 60
    assert engine.navigating
    assert states(out) == replayed(world, messages, found, refused(out))
    last, usual = ([o for o in run if isinstance(o, Estimate)][-1] for run in (out, clean))
    if all(abs(a[0] - b[0]) > 0.6 for i, a in enumerate(steps) for b in steps[:i]):
        assert np.linalg.norm(last.r_e - usual.r_e) < 0.5


@pytest.mark.parametrize('by_s', [3600.0, 2.0, -2.0, -10.0])
def test_a_step_of_all_clocks_changes_nothing_but_the_offset(world, events, clean, by_s):
    engine, out = live(world, stepped(events, [(5.0, by_s, '')]))
    assert states(out) == states(clean)
    steps = [o for o in out if isinstance(o, ClockStep)]
    assert {s.topic for s in steps} == {IMU, 'dvl/data', 'depth/data', 'acomms/rx'}
    assert {s.step_ns for s in steps} == {round(by_s * NS)}
    assert not refused(out)
    now_ns = events[-1].stamp_ns
    assert engine.clock.own_ns(now_ns) == now_ns + round(by_s * NS)
    at_ns = now_ns + round(by_s * NS)
    assert engine.clock.nearest_offset_ns(at_ns, now_ns) == -round(by_s * NS)
    assert engine.clock.nearest_offset_ns(now_ns, now_ns) == 0
    (imu,) = [c for c in engine.clock.conditions(now_ns) if IMU in c.sentence]
    assert f'stepped by {by_s:+.3f} s' in imu.sentence


def test_a_clock_of_its_own_keeps_its_offset_when_the_imus_steps(world, events, clean):
    messages = stepped(events, [(5.0, -10.0, IMU)])
    _, out = live(world, messages)
    assert {o.topic for o in out if isinstance(o, ClockStep)} == {IMU}
    assert states(out) == states(clean)


@pytest.mark.parametrize('by_s', [10.0, -10.0])
def test_a_step_of_the_dvls_own_clock_is_followed_after_three_pings(world, events, by_s):
    _, out = live(world, stepped(events, [(5.0, by_s, 'dvl/data')]))
    (step,) = [o for o in out if isinstance(o, ClockStep)]
    assert step.topic == 'dvl/data'
    assert step.step_ns == pytest.approx(by_s * NS, abs=2e7)
    late = refused(out)
    assert all(r.topic == 'dvl/data' and r.verdict is Verdict.TOO_LATE for r in late)
    assert len(late) <= 3


@pytest.mark.parametrize('count', [1, 4, 5, 6, 40])
def test_samples_of_2038_that_return_do_no_harm(world, events, clean, count):
    at = next(i for i, e in enumerate(events) if e.stamp_ns > world.stamps[500])
    wrong = [e for e in events[at:] if e.topic == IMU][:count]
    far_ns = (2**31 - 1) * NS - wrong[0].stamp_ns
    messages = [(e.stamp_ns, shifted(e, far_ns) if e in wrong else e) for e in events]
    engine, out = live(world, messages)
    assert engine.navigating
    assert engine.clock.offset_ns(IMU, 10**6) == 0
    steps = [o.step_ns for o in out if isinstance(o, ClockStep)]
    assert sum(steps) == 0
    assert len(steps) == (0 if count < 5 else 2)
    if count >= 5:
        assert states(out) == states(clean)


def gone(events, first_s, last_s, topics):
    start_ns = events[0].stamp_ns
    span = range(start_ns + round(first_s * NS), start_ns + round(last_s * NS))
    return [e for e in events if not (e.topic in topics and e.stamp_ns in span)]


@pytest.mark.parametrize('topics', [(IMU,), (IMU, 'dvl/data', 'depth/data', 'acomms/rx')])
def test_a_gap_is_no_step(world, events, topics):
    """By arrival, even if all topics are silent."""
    messages = [(e.stamp_ns, e) for e in gone(events, 5.0, 8.0, topics)]
    _, out = live(world, messages)
    assert not [o for o in out if isinstance(o, ClockStep)]
    assert not refused(out)


def test_a_step_in_a_gap_leaves_the_gap(world, events):
    messages = stepped(gone(events, 5.0, 7.0, (IMU,)), [(6.0, 100.0, IMU)])
    _, out = live(world, messages)
    (step,) = [o for o in out if isinstance(o, ClockStep)]
    assert step.step_ns == pytest.approx(100 * NS, abs=2e7)


def test_without_arrival_a_leap_of_a_minute_is_a_step_and_a_shorter_one_a_gap(world, events):
    for by_s, count in ((3.0, 0), (3600.0, 1)):
        messages = [(None, e) for _, e in stepped(events, [(5.0, by_s, IMU)])]
        _, out = live(world, messages)
        assert len([o for o in out if isinstance(o, ClockStep) and o.topic == IMU]) == count


def test_late_samples_are_no_step(world, events):
    """A block that fills a gap, jumbled samples, and a second IMU that is behind."""
    imu = [e for e in events if e.topic == IMU]
    times = [e.stamp_ns for e in imu]
    block = [*imu[:400], *imu[600:700], *imu[400:600], *imu[700:]]
    at_ns = [*times[:400], *times[600:700], *[times[700]] * 200, *times[700:]]
    orders = [list(zip(at_ns, block, strict=True))]
    rng = np.random.default_rng(3)
    orders.append(
        sorted(
            ((t + int(rng.integers(0, 2 * NS)), e) for t, e in zip(times, imu, strict=True)),
            key=lambda a: a[0],
        )
    )
    second = [(a.stamp_ns, x) for a, b in zip(imu[500:], imu, strict=False) for x in (a, b)]
    orders.append([*zip(times[:500], imu[:500], strict=True), *second])
    for order in orders:
        _, out = live(world, [(t, replace(e, sequence=k)) for k, (t, e) in enumerate(order)])
        assert not [o for o in out if isinstance(o, ClockStep)]


def test_a_short_step_back_without_arrival_is_late(world, events):
    messages = [(None, e) for _, e in stepped(events, [(5.0, -0.4, IMU)])]
    _, out = live(world, messages)
    assert not [o for o in out if isinstance(o, ClockStep)]
    assert {r.verdict for r in refused(out)} <= {Verdict.TOO_LATE, Verdict.DUPLICATE}
    assert len(refused(out)) in range(30, 50)


@pytest.mark.parametrize('by_s', [-0.03, -0.05, -0.11, -0.2, -0.4, 0.03, 0.1, 0.2, 0.24, 0.3, 0.4])
def test_a_short_step_of_the_imus_clock_is_followed(world, events, clean, by_s):
    """By arrival, which shows that samples go on; a replay does the same."""
    messages = stepped(events, [(5.0, by_s, IMU)])
    _, out = live(world, messages)
    steps = [o for o in out if isinstance(o, ClockStep)]
    assert [(o.topic, o.step_ns) for o in steps] == [(IMU, round(by_s * NS))]
    assert states(out) == states(clean) == replayed(world, messages, steps, refused(out))


@pytest.mark.parametrize('number', [8, 30])
def test_a_burst_of_late_samples_is_no_short_step(world, events, number):
    """Samples that were held up come at once, from a gap that was seen, or from none."""
    imu = [e for e in events if e.topic == IMU]
    late_ns = imu[440].stamp_ns
    held = imu[430 - number : 430]
    messages = sorted(
        ((late_ns + k if e in held else e.stamp_ns, e) for k, e in enumerate(imu)),
        key=lambda m: m[0],
    )
    _, out = live(world, messages)
    assert not [o for o in out if isinstance(o, ClockStep)]


@pytest.mark.parametrize('by_s', [0.2, 0.4])
def test_a_short_step_ahead_takes_no_sensor_away(world, events, by_s):
    """What is stamped after it came is put right after three seconds."""
    messages = stepped(events, [(4.0, by_s, 'dvl/data')])
    _, out = live(world, messages)
    steps = [o for o in out if isinstance(o, ClockStep)]
    assert {o.topic for o in steps} == {'dvl/data'}
    assert all(abs(o.step_ns * 1e-9 - by_s) <= 0.02 for o in steps)
    after_ns = max(o.stamp_ns for o in steps)
    assert not [o for o in refused(out) if o.topic == 'dvl/data' and o.stamp_ns > after_ns]
    assert states(out) == replayed(world, messages, steps, refused(out))


def test_others_are_put_beside_an_imu_whose_step_was_not_seen(world, events):
    """Its samples come jumbled, so that arrival tells too little."""
    jumbled = [
        (arrival_ns + (15 * NS // 1000 if e.topic == IMU and k % 20 == 0 else 0), e)
        for k, (arrival_ns, e) in enumerate(stepped(events, [(4.0, 0.2, IMU)]))
    ]
    _, out = live(world, sorted(jumbled, key=lambda m: m[0]))
    steps = {o.topic: o.step_ns * 1e-9 for o in out if isinstance(o, ClockStep)}
    assert IMU not in steps
    assert {'dvl/data', 'depth/data'} <= steps.keys()
    assert all(by_s == pytest.approx(-0.2, abs=0.03) for by_s in steps.values())


@pytest.mark.parametrize(
    ('first_s', 'second_s'), [(-0.3, 0.3), (-0.1, 0.3), (0.1, -0.06), (0.1, 0.1), (-0.1, -0.1)]
)
def test_short_steps_of_the_imu_both_ways_are_followed(world, events, first_s, second_s):
    messages = stepped(events, [(3.0, first_s, IMU), (6.0, second_s, IMU)])
    _, out = live(world, messages)
    steps = [o.step_ns * 1e-9 for o in out if isinstance(o, ClockStep) and o.topic == IMU]
    assert steps == pytest.approx([first_s, second_s], abs=0.02)


@pytest.mark.parametrize('ahead', [1, 5])
@pytest.mark.parametrize('by_s', [0.04, 0.07, 0.2])
def test_samples_that_were_stamped_ahead_for_a_moment_leave_no_offset(world, events, ahead, by_s):
    imu = [e for e in events if e.topic == IMU]
    messages = [
        (e.stamp_ns, shifted(e, round(by_s * NS)) if 430 <= k < 430 + ahead else e)
        for k, e in enumerate(imu)
    ]
    _, out = live(world, messages)
    steps = [o.step_ns for o in out if isinstance(o, ClockStep)]
    assert len(steps) == (0 if ahead == 1 else 2)
    assert sum(steps) == 0


@pytest.mark.parametrize(
    'order', [(1, 0), (2, 0, 1), (3, 0, 1, 2), (2, 1, 0), (4, 5, 0, 1, 2, 3), (1, 0, 3, 2, 5, 4)]
)
def test_samples_that_overtook_one_another_are_no_step_back(world, events, order):
    imu = [e for e in events if e.topic == IMU]
    arrivals = [e.stamp_ns for e in imu]
    imu[430 : 430 + len(order)] = [imu[430 + k] for k in order]
    _, out = live(world, list(zip(arrivals, imu, strict=True)))
    assert not [o for o in out if isinstance(o, ClockStep)]


def test_messages_that_are_late_for_a_second_are_not_put_elsewhere(world, events):
    """A computer that is busy: what comes next is in time again."""
    at_ns = events[0].stamp_ns + 5 * NS
    messages = sorted(
        (
            (
                e.stamp_ns
                + (NS // 5 if e.topic != IMU and at_ns < e.stamp_ns < at_ns + NS else 0),
                e,
            )
            for e in events
        ),
        key=lambda m: m[0],
    )
    _, out = live(world, messages)
    assert not [o for o in out if isinstance(o, ClockStep)]
    assert refused(out)


def test_a_packet_keeps_the_validity_of_its_senders_clock():
    v_m = np.zeros(3)
    clocks = Clocks(0.25)
    for k in range(10):
        clocks.take(ImuSample(k * NS // 100, k, v_m, v_m))
    for k in range(10, 20):
        clocks.take(ImuSample(3600 * NS + k * NS // 100, k, v_m, v_m))
    fix = Fix(1, 2, 3600 * NS + NS // 5, 'leader', 0, 0, 7, v_m, np.eye(3))
    step, one = clocks.take(fix)
    assert (step.topic, step.number, step.offset_ns) == ('acomms/rx', 7, -3600 * NS)
    assert (one.validity_ns, one.receive_ns, one.transmit_ns) == (1, NS // 5, 2 - 3600 * NS)
    absolute = replace(fix, validity_ns=3600 * NS + NS // 5, topic='absolute/fix')
    _, one = clocks.take(absolute)
    assert one.validity_ns == one.receive_ns == NS // 5  # of this vehicle's own clock


def test_one_ping_ahead_is_refused_and_waiting_ones_end_with_the_run():
    v_m = np.zeros(3)
    clocks = Clocks(0.25)
    for k in range(300):
        clocks.take(ImuSample(k * NS // 100, k, v_m, v_m), k * NS // 100)

    def ping(stamp_s, number):
        sample = DvlPing(round(stamp_s * NS), number, True, v_m, np.eye(3))
        return clocks.take(sample, 3 * NS + number * NS // 5)

    assert ping(3.0, 0)[0].stamp_ns == 3 * NS
    assert ping(9.0, 1) == []
    first, second = ping(3.4, 2)
    assert isinstance(first, Refused)
    assert first.event.sequence == 1
    assert second.sequence == 2
    assert ping(60.0, 3) == []
    (last,) = clocks.flush()
    assert isinstance(last, Refused)


@pytest.mark.parametrize('by_s', [-1000.0, 1000.0])
def test_stamps_that_stick_are_refused_and_do_not_pile_up(world, events, by_s):
    """A driver whose stamps stop: nothing agrees with them, and nothing waits for ever."""
    stuck_ns = events[0].stamp_ns + round(by_s * NS)
    half = events[len(events) // 2].stamp_ns
    messages = [
        (e.stamp_ns, replace(e, stamp_ns=stuck_ns) if isinstance(e, ImuSample) else e)
        if e.stamp_ns > half
        else (e.stamp_ns, e)
        for e in events
    ]
    engine, out = live(world, messages)
    held = [r for r in refused(out) if r.topic == IMU]
    assert len(held) >= 256 + 200
    assert engine.last_imu_ns <= half


def test_a_saved_state_has_the_imus_own_time(world, events):
    messages = stepped(events, [(4.0, 30.0, '')])
    engine, _ = live(world, messages)
    (newest,) = [e for _, e in messages if isinstance(e, ImuSample)][-1:]
    assert abs(engine.saved().stamp_ns - newest.stamp_ns) <= NS // 10
    assert abs(engine.fusion.stamp_ns - newest.stamp_ns) >= 29 * NS


@pytest.mark.parametrize('steps', [(-3.0, 5.0), (3.0, -5.0), (-10.0, 18.0)])
def test_a_topic_that_was_silent_has_made_the_first_of_two_steps(world, events, steps):
    """The second one was of the IMU's clock alone: no offset that the IMU has now fits."""
    both, alone = steps
    messages = stepped(events, [(5.0, both, ''), (6.5, alone, IMU)])
    first_ns = messages[0][0]
    heard = [
        (ns, e)
        for ns, e in messages
        if isinstance(e, ImuSample) or not 4 <= (ns - first_ns) / NS < 8
    ]
    engine, out = live(world, heard)
    assert not [r for r in refused(out) if r.topic != IMU]
    newest_ns = {e.topic: e.stamp_ns + engine.clock.offset_ns(e.topic, 10**9) for _, e in heard}
    assert newest_ns['dvl/data'] > newest_ns[IMU] - NS


WRAPPED_NS = (1 << 32) * 100_000


@pytest.mark.parametrize('by_s', [-1.7e9, -3e5, 3e5, 3.7e8])
def test_a_clock_that_steps_by_days_takes_no_fix_away(world, events, clean, by_s):
    """Times of packets wrap after 4.97 days, and are read beside the clock that has stepped."""

    def as_read(event):
        if not isinstance(event, Fix):
            return event
        apart = (event.validity_ns - event.receive_ns + WRAPPED_NS // 2) % WRAPPED_NS
        return replace(event, validity_ns=event.receive_ns + apart - WRAPPED_NS // 2)

    messages = [(ns, as_read(e)) for ns, e in stepped(events, [(6.0, by_s, '')])]
    assert messages[-1][1].stamp_ns - messages[-1][0] == round(by_s * NS)
    assert states(live(world, messages)[1]) == states(clean)
