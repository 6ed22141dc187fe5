"""A follower under a flood: what waits is bounded, all gets a verdict, a replay has the same."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from polar_nav_core.engine import reorder
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import DvlPing, Fix, ImuSample
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.reorder import Reorder
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_follower.params import FollowerParams

S = 10**9
START_NS = 1_772_323_200 * S
PARAMS = FollowerParams()


def imu(k, rate_hz):
    force = np.array([0.0, 0.0, 9.83 + 1e-12 * (k % 7)])
    return ImuSample(START_NS + k * S // rate_hz, k, np.zeros(3), force)


def packet(k, receive_ns):
    """Packet of somebody who floods the link: other content each time."""
    r_e = np.array([0.0, 1e-3 * k, 6.3567e6])
    return Fix(
        validity_ns=receive_ns - S,
        transmit_ns=receive_ns - S // 2,
        receive_ns=receive_ns,
        source='leader',
        sequence=k % 65536,
        order=k,
        arrival=k,
        r_e=r_e,
        covariance_e=np.eye(3),
    )


def ping(k, stamp_ns):
    return DvlPing(stamp_ns, k, True, np.zeros(3), 1e-4 * np.eye(3))


def live(events):
    """Outputs of a live run, and the most that ever waited in it."""
    engine = Engine(PARAMS)
    order = Reorder(engine, PARAMS.reorder_window_s, PARAMS.max_stamp_leap_s)
    out, most = [], 0
    for event in events:
        out += order.add(event)
        most = max(most, order.pending)
    return engine, [*out, *order.flush()], most


def plain(outputs, kind):
    return [repr(o) for o in outputs if isinstance(o, kind)]


def replayed(events, outputs):
    """Outputs of the same events in their total order, without those that were refused."""
    refused = {(r.topic, r.sequence) for r in outputs if is_late(r)}
    engine = Engine(PARAMS)
    kept = [e for e in events if (e.topic, e.sequence) not in refused]
    out = []
    for event in sorted(kept, key=lambda e: e.key):
        out += engine.process(event)
    return [*out, *engine.finish()]


def is_late(output):
    return isinstance(output, Receipt) and output.verdict is Verdict.TOO_LATE


@pytest.mark.slow
def test_a_thousand_packets_a_second():
    seconds, per_s = 4, 1000
    events = [imu(k, 100) for k in range(100 * seconds)]
    events += [packet(k, START_NS + S // 10 + k * S // per_s) for k in range(per_s * seconds)]
    events.sort(key=lambda e: e.stamp_ns)
    engine, out, most = live(events)
    receipts = [o for o in out if isinstance(o, Receipt)]
    assert len(receipts) == per_s * seconds
    assert most < 2 * per_s * PARAMS.reorder_window_s + 1000
    assert sum(engine.verdicts.values()) == per_s * seconds
    again = replayed(events, out)
    assert plain(out, Estimate) == plain(again, Estimate)
    assert plain(out, Receipt) == plain(again, Receipt)


@pytest.mark.slow
def test_an_imu_of_ten_kilohertz():
    events = [imu(k, 10_000) for k in range(8_000)]
    engine, out, most = live(events)
    assert most <= 10_000 * PARAMS.reorder_window_s + 300
    assert engine.navigating
    assert plain(out, Estimate) == plain(replayed(events, out), Estimate)


@pytest.mark.slow
def test_a_sensor_that_floods_while_the_imu_is_silent_has_a_bound(monkeypatch):
    """Nothing moves time on, so that everything waits."""
    monkeypatch.setattr(reorder, '_MOST_WAITING', 500)
    silent_ns = START_NS + S // 2
    before = [imu(k, 100) for k in range(50)]
    flood = [ping(k, silent_ns + k * 1000) for k in range(2000)]
    after = [imu(k, 100) for k in range(51, 200)]
    events = [*before, *flood, *after]
    _, out, most = live(events)
    assert most <= 500 + 100
    late = [o for o in out if is_late(o)]
    assert len(late) > 1300
    assert {o.reason for o in late} == {'500 messages wait for the IMU already'}
    assert plain(out, Estimate) == plain(replayed(events, out), Estimate)
