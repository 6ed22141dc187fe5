"""A sensor that is switched off: its messages change nothing, and each has a receipt."""

import numpy as np
import pytest
from closed_loop import START_NS, World, run

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind, HeadingSample
from polar_nav_core.engine.health.conditions import Culprit, Level
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.verdicts import Verdict

OFF_NS, ON_NS = START_NS + 4_000_000_000, START_NS + 8_000_000_000


@pytest.fixture(scope='module')
def world():
    return World(12.0)


def events_of(world):
    rng = np.random.default_rng(2)
    aiding = [*world.dvl(rng=rng), *world.depth(rng=rng)]
    headings = [
        HeadingSample(int(world.stamps[k]), i, float(np.arctan2(C[0, 0], C[1, 0])))
        for i, k in enumerate(range(50, world.n + 1, 50))
        for C in [world.C_b_G[k]]
    ]
    return [*world.imu(), *aiding, *headings, *world.fixes(1.0, 0.5, rng=rng)]


def switched(topic):
    return [
        Command(OFF_NS, 0, CommandKind.SENSOR_OFF, sensor=topic),
        Command(ON_NS, 1, CommandKind.SENSOR_ON, sensor=topic, arrival=1),
    ]


@pytest.mark.parametrize('topic', ['dvl/data', 'depth/data', 'heading/data', 'acomms/rx'])
def test_what_is_switched_off_might_not_have_come(world, topic):
    events = events_of(world)
    unused = [e for e in events if e.topic == topic and OFF_NS < e.stamp_ns <= ON_NS]
    assert len(unused) >= 4
    params = world.params(heading_reference='grid')
    engine = Engine(params)
    with_switch = run(engine, [*events, *switched(topic)])
    without = run(Engine(params), [e for e in events if all(e is not u for u in unused)])

    refused = [r for r in with_switch if isinstance(r, Receipt) and r.topic == topic]
    refused = [r for r in refused if r.verdict is Verdict.SWITCHED_OFF]
    assert [r.stamp_ns for r in refused] == sorted(u.stamp_ns for u in unused)
    assert {r.reason for r in refused} == {f'{topic} is switched off'}
    mine, others = ([o for o in out if isinstance(o, Estimate)] for out in (with_switch, without))
    assert len(mine) == len(others) > 100
    for a, b in zip(mine, others, strict=True):
        assert a.stamp_ns == b.stamp_ns
        np.testing.assert_array_equal(a.r_e, b.r_e)
        np.testing.assert_array_equal(a.P, b.P)
    assert engine.health is not None
    assert all(p.condition.key != 'switched off' for p in engine.health.present)


@pytest.mark.parametrize(
    ('topic', 'culprit'),
    [
        ('dvl/data', Culprit.DVL),
        ('heading/data', Culprit.HEADING),
        ('/ugps/fix', Culprit.FIXES),
    ],
)
def test_a_warning_names_it_also_after_a_reset(world, topic, culprit):
    engine = Engine(world.params())
    reset = Command(OFF_NS + 1, 1, CommandKind.RESET, world_start(world), arrival=1)
    run(engine, [*events_of(world), switched(topic)[0], reset])
    (found,) = (p.condition for p in engine.health.present if p.condition.key == 'switched off')
    assert (found.level, found.culprit) == (Level.WARN, culprit)
    assert found.sentence == f'switched off by a service call: {topic}'


def world_start(world):
    return world.params().initial_state()
