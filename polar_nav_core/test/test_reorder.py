"""Live order equals sorted order: within the window, any transport gives the same bits."""

import random
from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, run
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_core.engine import reorder
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.reorder import Reorder
from polar_nav_core.engine.verdicts import Verdict

WINDOW_S = 0.2


@pytest.fixture(scope='module')
def world():
    return World(12.0)


def events_of(world):
    rng = np.random.default_rng(5)
    fixes = world.fixes(1.0, 1.7, rng=rng)
    return [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng), *fixes]


def live(world, arrivals, window_s=WINDOW_S):
    driver = Reorder(Engine(world.params(reorder_window_s=window_s)), window_s, 0.25)
    out = []
    for event in arrivals:
        out.extend(driver.add(event))
    out.extend(driver.flush())
    return driver, out


def same(a, b):
    assert len(a) == len(b)
    for x, y in zip(a, b, strict=True):
        assert type(x) is type(y)
        assert x.stamp_ns == y.stamp_ns
        if isinstance(x, Estimate):
            assert x.r_e.tobytes() == y.r_e.tobytes()
            assert x.P.tobytes() == y.P.tobytes()
        else:
            assert (x.verdict, x.sequence, x.nis) == (y.verdict, y.sequence, y.nis)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32))
def test_any_jitter_within_the_window_gives_the_same_bits(world, seed):
    events = events_of(world)
    shuffle = random.Random(seed)
    arrivals = sorted(
        events, key=lambda e: (e.stamp_ns + shuffle.randrange(0, int(WINDOW_S * 0.99e9)), e.key)
    )
    _, out = live(world, arrivals)
    same(out, run(Engine(world.params()), events))


def test_what_comes_after_the_window_is_refused_with_numbers(world):
    events = sorted(events_of(world), key=lambda e: e.key)
    late = next(e for e in events if e.topic == 'dvl/data' and e.stamp_ns > world.stamps[500])
    events.remove(late)
    at = next(i for i, e in enumerate(events) if e.stamp_ns > late.stamp_ns + 2 * WINDOW_S * 1e9)
    _, out = live(world, [*events[:at], late, *events[at:]])
    refused = [o for o in out if isinstance(o, Receipt) and o.verdict is Verdict.TOO_LATE]
    assert [(r.topic, r.sequence, r.validity_ns) for r in refused] == [
        ('dvl/data', late.sequence, late.stamp_ns)
    ]
    assert 'reorder window' in refused[0].reason
    without = [o for o in out if not (isinstance(o, Receipt) and o.verdict is Verdict.TOO_LATE)]
    same(without, run(Engine(world.params()), events))


def test_flush_gives_what_the_window_held(world):
    driver, out = live(world, sorted(events_of(world), key=lambda e: e.key))
    last = [o for o in out if isinstance(o, Estimate)][-1]
    assert last.stamp_ns == world.stamps[-1]
    assert driver.pending == 0


def test_one_imu_stamp_ahead_waits_and_is_refused_when_the_next_does_not_agree(world):
    events = sorted(events_of(world), key=lambda e: e.key)
    at = next(i for i, e in enumerate(events) if e.stamp_ns > world.stamps[500])
    wrong = next(e for e in events[at:] if e.topic == 'imu/data_raw')
    for ahead_s in (5.0, 4.0e8):
        ahead = replace(wrong, stamp_ns=wrong.stamp_ns + round(ahead_s * 1e9), sequence=10**6)
        driver, out = live(world, [*events[:at], ahead, ahead, *events[at:]])
        refused = [o for o in out if isinstance(o, Receipt) and o.topic == 'imu/data_raw']
        assert [r.verdict for r in refused] == 2 * [Verdict.FROM_FUTURE]
        assert 'did not agree' in refused[0].reason
        others = [o for o in out if not (isinstance(o, Receipt) and o.topic == wrong.topic)]
        same(others, run(Engine(world.params()), events))
        assert driver.pending == 0


def test_a_stream_that_goes_on_after_a_leap_is_taken(world):
    """A gap of 3 s: its first sample waits for the second, and none is lost."""
    gap = range(int(world.stamps[500]), int(world.stamps[800]))
    events = [e for e in events_of(world) if not (e.topic == 'imu/data_raw' and e.stamp_ns in gap)]
    events.sort(key=lambda e: e.key)
    _, out = live(world, events)
    same(out, run(Engine(world.params()), events))


def test_the_first_stamp_of_a_run_needs_a_second_that_agrees(world):
    events = sorted(events_of(world), key=lambda e: e.key)
    ahead = replace(events[0], stamp_ns=2**31 * 10**9 - 1, sequence=10**6)
    _, out = live(world, [ahead, *events])
    assert next(o.verdict for o in out if isinstance(o, Receipt)) is Verdict.FROM_FUTURE
    same(out[1:], run(Engine(world.params()), events))


def test_packets_far_ahead_of_the_imu_do_not_wait(world, monkeypatch):
    """They would never be due: 20,000 of 2038 stayed in memory."""
    events = sorted(events_of(world), key=lambda e: e.key)
    fix = next(e for e in events if isinstance(e, Fix))
    ahead = [replace(fix, receive_ns=fix.receive_ns + 10**12, arrival=500 + k) for k in range(50)]
    _, out = live(world, [*events[:100], *ahead, *events[100:]])
    refused = [o for o in out if isinstance(o, Receipt) and o.verdict is Verdict.TOO_LATE]
    assert len(refused) == len(ahead)
    assert 'ahead of the newest IMU sample' in refused[0].reason
    clean = [o for o in live(world, events)[1] if isinstance(o, Estimate)]
    same([o for o in out if isinstance(o, Estimate)], clean)
    monkeypatch.setattr(reorder, '_MOST_WAITING', 30)
    few = Reorder(Engine(world.params()), WINDOW_S, 0.25)
    out = [o for k in range(50) for o in few.add(replace(fix, arrival=k))]
    assert few.pending == 30
    assert [o.verdict for o in out] == [Verdict.TOO_LATE] * 20
