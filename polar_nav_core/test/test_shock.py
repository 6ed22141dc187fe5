"""An IMU sample that differs from the one before by far too much is half believed."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core import attitude
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import ImuSample
from polar_nav_core.engine.health.conditions import Level
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.sins.history import make_past
from polar_nav_core.engine.sins.log import make_log
from polar_nav_core.engine.sins.settings import make_settings
from polar_nav_core.kernels.sins import state as fs
from polar_nav_core.kernels.sins.shock import doubt_shock
from polar_nav_core.kernels.sins.work import make_work

S = 1_000_000_000
PERIOD_NS = 20_000_000
SETTINGS = make_settings(EngineParams())
WALK_RATE, WALK_FORCE = 0.02, 0.3
LOG = make_log(make_past(1.0, 0.1))
C_B_G = attitude.exp(np.array([0.3, -0.2, 1.1]))


class Samples:
    """A filter's state that gets samples of an IMU, one every 20 ms."""

    def __init__(self, settings=SETTINGS, seed=1):
        self.state, self.work, self.settings = fs.make_state(), make_work(), settings
        self.state.C_b_G[:] = C_B_G
        self.state.P[:] = 1e-6 * np.eye(24)
        self.draw = np.random.default_rng(seed)
        self.stamp_ns = 100 * S

    def next(self, rate, force, after_ns=PERIOD_NS, up=0.0):
        """Take a sample: a rate about x, a force along y, and one along z beside gravity."""
        omega, f = np.array([rate, 0.0, 0.0]), np.array([0.0, force, 9.81 + up])
        self.stamp_ns += after_ns
        s = self.state
        s.counters[fs.USUAL_NS] = PERIOD_NS
        doubt_shock(s, self.settings, self.work, LOG, self.stamp_ns, omega, f)
        s.previous[0], s.previous[1] = omega, f
        s.counters[fs.IMU_NS], s.counters[fs.HAS_PREVIOUS] = self.stamp_ns, 1
        return int(s.counters[fs.SHOCK_NS]) == self.stamp_ns

    def usual(self, number, rate=0.0, force=0.0):
        """Whether one of so many samples of noise was unusual."""
        noise = self.draw.normal(size=(number, 2)) * (rate, force)
        return any([self.next(*row) for row in noise.tolist()])


def test_a_leap_makes_attitude_and_velocity_as_uncertain_as_it_may_be_off():
    samples = Samples()
    assert not samples.usual(200)
    before = samples.state.P.copy()
    assert samples.next(0.5, -20.0)
    grown = samples.state.P - before
    # By what the sample moves them, in grid axes; nothing else is touched.
    turned, pushed = C_B_G[:, 0] * 0.5 * 0.02, C_B_G[:, 1] * 20.0 * 0.02
    np.testing.assert_allclose(grown[:3, :3], np.outer(turned, turned), atol=1e-15)
    np.testing.assert_allclose(grown[3:6, 3:6], np.outer(pushed, pushed), atol=1e-15)
    grown[:3, :3] = grown[3:6, 3:6] = 0.0
    assert not grown.any()
    # Back is a leap as well, and then all is as before.
    assert samples.next(0.0, 0.0)
    assert not samples.usual(100)


def test_every_axis_counts():
    samples = Samples()
    samples.usual(200)
    assert samples.next(0.0, 0.0, up=-4.0)


@pytest.mark.parametrize(
    ('rate', 'force', 'expected'),
    [(0.17, 0.0, True), (0.15, 0.0, False), (0.0, 3.5, True), (0.0, 3.3, False)],
)
def test_what_a_vehicle_does_by_itself_is_no_leap(rate, force, expected):
    samples = Samples()
    samples.usual(200)
    assert samples.next(rate, force) is expected


def test_on_a_vehicle_that_shakes_what_is_usual_is_no_leap():
    samples = Samples()
    assert not samples.usual(500, rate=0.1, force=3.0)
    assert not samples.next(0.9, 0.0)
    samples.next(0.0, 0.0)
    assert samples.next(3.0, 0.0)


def test_what_is_usual_is_a_mean_over_ten_seconds_and_of_all_samples_before():
    samples = Samples(seed=1)
    samples.usual(802, rate=0.01)
    squares = np.diff(np.random.default_rng(1).normal(size=(802, 2))[:, 0] * 0.01) ** 2
    expected = squares[:500].mean()
    for square in squares[500:]:
        expected += (square - expected) * 0.02 / 10.0
    assert samples.state.usual[0] == pytest.approx(expected, rel=1e-12)


def test_a_vehicle_that_begins_to_shake_is_soon_as_usual():
    samples = Samples()
    samples.usual(1000, rate=1e-3, force=0.02)
    assert samples.usual(50, rate=0.2, force=5.0)
    assert not samples.usual(1000, rate=0.2, force=5.0)


def test_nothing_is_unusual_at_first_nor_after_samples_that_are_missing():
    samples = Samples()
    samples.usual(50)
    assert not samples.next(0.5, 20.0)
    samples = Samples()
    samples.usual(200)
    assert not samples.next(0.5, 20.0, after_ns=2 * PERIOD_NS)
    samples = Samples()
    samples.usual(200)
    samples.state.counters[fs.HAS_PREVIOUS] = 0  # after a gap that was bridged
    assert not samples.next(0.5, 20.0)


@pytest.fixture(scope='module')
def world():
    return World(60.0)


def struck(world, at_s, force=0.0, rate=0.0):
    """Events of a run with one sample that says too much."""
    fixes = world.fixes(1.0, 1.5, rng=np.random.default_rng(3))
    events = list(inputs_of(world, fixes).events())
    at_ns = events[0].stamp_ns + round(at_s * 1e9)
    k = next(k for k, e in enumerate(events) if isinstance(e, ImuSample) and e.stamp_ns >= at_ns)
    events[k] = replace(
        events[k],
        omega_ib_b=events[k].omega_ib_b + np.array([rate, 0.0, 0.0]),
        f_b=events[k].f_b + np.array([0.0, force, 0.0]),
    )
    return events


def errors(world, outputs, since_s):
    index = {int(stamp): k for k, stamp in enumerate(world.stamps)}
    since_ns = int(world.stamps[0]) + round(since_s * 1e9)
    return np.array([
        np.linalg.norm(o.r_e - world.r_e[index[o.stamp_ns]])
        for o in outputs
        if isinstance(o, Estimate) and o.stamp_ns >= since_ns
    ])  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize('strategy', ['clone', 'rewind'])
@pytest.mark.parametrize('wrong', [{'force': 45.0}, {'rate': 0.45}])
def test_a_sample_that_never_was_does_no_harm(world, wrong, strategy):
    """Pings are not refused, and the estimate stays where it was; without it they are."""
    found = {}
    for shock in (10.0, 0.0):
        params = world.params(configuration='default', delay_handling=strategy, imu_shock=shock)
        engine = Engine(params)
        outputs = [o for event in struck(world, 30.0, **wrong) for o in engine.process(event)]
        refused = sum(isinstance(o, Receipt) and o.verdict.name == 'GATED' for o in outputs)
        said = [p.condition for p in engine.health.present if p.condition.key == 'IMU shock']
        found[shock] = errors(world, outputs, 30.0).max(), refused, [c.level for c in said]
    largest, refused, said = found[10.0]
    assert largest < 1.0
    assert not refused
    assert said == [Level.WARN]
    assert found[0.0][0] > 2.0 * largest
    assert found[0.0][2] == []
