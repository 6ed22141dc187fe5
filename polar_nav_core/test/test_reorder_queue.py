"""The queue alone, before an engine that only notes what it is given."""

from types import SimpleNamespace

import numpy as np
import pytest
from fix_samples import S, fix

from polar_nav_core.engine import reorder
from polar_nav_core.engine.events import ClockStep, Command, CommandKind, DepthSample, ImuSample
from polar_nav_core.engine.reorder import Reorder
from polar_nav_core.engine.verdicts import Verdict

MS = 1_000_000


class Notes:
    """An engine that notes what it processes, how far it advances, what it refuses."""

    def __init__(self):
        self.done, self.advanced, self.finished, self.steps = [], [], False, []
        self.clock = SimpleNamespace(note=self.steps.append)

    def process(self, event):
        self.done.append(event)
        yield event

    def advance(self, stamp_ns):
        self.advanced.append(stamp_ns)
        yield from ()

    def finish(self):
        self.finished = True
        yield from ()

    def refuse(self, event, verdict, reason, stamp_ns):
        return SimpleNamespace(event=event, verdict=verdict, reason=reason, stamp_ns=stamp_ns)


def queue(window_s=0.2, leap_s=0.25):
    return Reorder(Notes(), window_s, leap_s)


def imu(ms, number=0):
    return ImuSample(ms * MS, number, np.zeros(3), np.array([0.0, 0.0, 9.8]))


def depth(ms, number=0):
    return DepthSample(ms * MS, number, 10.0, 0.01)


def feed(driver, *events):
    return [o for e in events for o in driver.add(e)]


def fill(driver, last_ms, first_ms=1000, every=100):
    return feed(driver, *(imu(t) for t in range(first_ms, last_ms + 1, every)))


def stamps(events):
    return [e.stamp_ns // MS for e in events]


def test_messages_up_to_the_watermark_are_processed_and_time_advances_past_it():
    driver = queue()
    fill(driver, 1500)
    assert driver.watermark_ns == 1300 * MS
    assert driver.newest_imu_ns == 1500 * MS
    assert stamps(driver.engine.done) == [1000, 1100, 1200, 1300]
    assert driver.pending == 2
    assert driver.engine.advanced[-1] == 1300 * MS + 1


def test_what_is_at_the_watermark_is_late_and_what_is_after_it_is_not():
    driver = queue()
    fill(driver, 1500)
    (late,) = feed(driver, depth(1300))
    assert (late.verdict, late.stamp_ns) == (Verdict.TOO_LATE, 1300 * MS)
    assert late.reason == ('0.200 s behind the newest IMU sample, the reorder window is 0.200 s')
    (later,) = feed(driver, depth(1150))
    assert later.reason.startswith('0.350 s behind')
    assert feed(driver, DepthSample(1300 * MS + 1, 0, 10.0, 0.01)) == []
    assert driver.pending == 3


def test_the_order_is_that_of_stamps_whatever_comes_first():
    driver = queue(window_s=0.5)
    fill(driver, 1400)
    out = feed(driver, depth(1450, 2), depth(1350, 1), imu(1500), imu(1800), imu(2000), imu(2200))
    assert stamps(out) == sorted(stamps(out))
    assert stamps(driver.engine.done) == [1000, 1100, 1200, 1300, 1350, 1400, 1450, 1500]


def test_a_sample_of_the_imu_that_is_late_moves_nothing_back():
    driver = queue()
    fill(driver, 1500)
    feed(driver, imu(1400, 7))
    assert driver.newest_imu_ns == 1500 * MS
    assert driver.watermark_ns == 1300 * MS


@pytest.mark.parametrize(('window_s', 'start_ms'), [(0.2, 1000), (0.0, 1400)])
def test_an_event_at_the_start_is_never_late(window_s, start_ms):
    driver = queue(window_s)
    assert driver.start_ns is None
    fill(driver, 1100)
    assert driver.start_ns == (1000 * MS if window_s else 1100 * MS + 1)
    fill(driver, 1400, 1200)
    assert driver.start_ns == max(1000 * MS, driver.watermark_ns + 1)
    assert driver.start_ns // MS == (1200 if window_s else start_ms)
    command = Command(driver.start_ns, 0, CommandKind.RESET)
    assert not any(hasattr(o, 'verdict') for o in feed(driver, command))


def test_the_watermark_is_the_window_behind_to_the_nanosecond():
    driver = queue(window_s=10.0)
    fill(driver, 1500)
    assert driver.watermark_ns == 1500 * MS - 10 * S


def test_stamps_that_begin_at_nothing_are_stamps():
    driver = queue(window_s=0.01)
    feed(driver, imu(0), imu(10))
    assert driver.watermark_ns == 0
    assert driver.start_ns == 1


def test_a_command_has_the_time_of_the_engine():
    """No clock of a sensor: it is never judged as ahead."""
    driver = queue()
    fill(driver, 1500)
    command = Command(100 * S, 0, CommandKind.RESET)
    assert feed(driver, command) == []
    assert driver.pending == 3


@pytest.mark.parametrize(
    ('ahead_s', 'waits'), [(59.9, True), (60.0, True), (60.000000001, False), (75.4, False)]
)
def test_a_packet_waits_for_the_imu_for_a_minute(ahead_s, waits):
    driver = queue()
    fill(driver, 1500)
    out = feed(driver, fix(1, 1.4, 1.5 + ahead_s))
    if waits:
        assert (out, driver.pending) == ([], 3)
        return
    (refused,) = out
    assert (refused.verdict, refused.stamp_ns) == (Verdict.TOO_LATE, 1300 * MS)
    assert refused.reason == f'received {ahead_s:.0f} s ahead of the newest IMU sample'


def test_messages_before_the_first_sample_wait_as_far_as_there_is_room(monkeypatch):
    monkeypatch.setattr(reorder, '_MOST_WAITING', 3)
    driver = queue()
    out = feed(driver, *(fix(k, 200.0 + k) for k in range(5)))
    assert driver.pending == 3
    assert [(o.verdict, o.stamp_ns) for o in out] == [(Verdict.TOO_LATE, 0)] * 2
    assert out[0].reason == '3 messages wait for the IMU already'
    # Other sensors are refused for it, too; the IMU, by which time goes on, never is.
    (refused,) = feed(driver, depth(150))
    assert refused.reason == out[0].reason
    fill(driver, 1200)
    assert driver.newest_imu_ns == 1200 * MS


def test_there_is_room_for_a_mission_of_packets():
    assert reorder._MOST_WAITING == 65536


def test_a_stamp_ahead_that_nothing_agrees_with_is_refused_by_how_far():
    driver = queue()
    fill(driver, 1500)
    assert feed(driver, imu(4000, 5)) == []
    refused, *_ = feed(driver, imu(1600), imu(1700))
    assert (refused.verdict, refused.stamp_ns) == (Verdict.FROM_FUTURE, 1300 * MS)
    # Ahead of the newest sample, which is the one that did not agree.
    assert refused.reason == '2.400 s ahead of its stream, and the next message did not agree'
    first = queue()
    feed(first, imu(9_000_000, 5))
    (refused,) = feed(first, imu(1000))
    assert refused.reason.startswith('0.000 s ahead')
    assert refused.stamp_ns == 0


def test_a_step_of_the_clock_is_noted_by_the_engine_and_published():
    driver = queue()
    for t in range(1000, 2001, 10):
        list(driver.add(imu(t, t), t * MS))
    out = [o for t in range(2010, 2101, 10) for o in driver.add(imu(t + 60_000, t), t * MS)]
    (step,) = [o for o in out if isinstance(o, ClockStep)]
    assert driver.engine.steps == [step]
    assert step.step_ns == pytest.approx(60 * S, abs=0.02 * S)
    assert driver.newest_imu_ns == 2100 * MS


def test_the_end_of_a_run_processes_what_waits_and_finishes():
    driver = queue()
    fill(driver, 1500)
    feed(driver, depth(1480), imu(4000, 5))
    out = list(driver.flush())
    assert stamps(driver.engine.done[-3:]) == [1400, 1480, 1500]
    assert [o.verdict for o in out if hasattr(o, 'verdict')] == [Verdict.FROM_FUTURE]
    assert driver.pending == 0
    assert driver.engine.finished
