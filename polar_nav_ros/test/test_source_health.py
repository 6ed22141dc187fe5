"""What a node knows of its sources and no filter does: absent, of another type or QoS, silent."""

from types import SimpleNamespace

import pytest

rclpy = pytest.importorskip('rclpy')

from polar_nav_core.engine.health.conditions import Culprit, Level  # noqa: E402
from polar_nav_ros import topics  # noqa: E402
from polar_nav_ros.diagnostics import Diagnosis  # noqa: E402
from polar_nav_ros.diagnostics import Level as Worst  # noqa: E402
from polar_nav_ros.source_health import SourceHealth  # noqa: E402

TYPES = {'imu': 'Imu', 'velocity': 'Twist', 'depth': 'FluidPressure', 'position': 'NavSatFix'}


def offer(kind, reliability='BEST_EFFORT', durability='VOLATILE'):
    profile = SimpleNamespace(
        reliability=SimpleNamespace(name=reliability), durability=SimpleNamespace(name=durability)
    )
    return SimpleNamespace(topic_type=kind, qos_profile=profile)


class Rig:
    """A node with a source of each role, all heard, by clocks and counts that the test moves."""

    def __init__(self, silent_s=30.0, lockstep=False):
        self.said = []
        self.now_s = 100.0
        self.heard = dict.fromkeys((f'/{role}' for role in TYPES), 1)
        self.taken = dict.fromkeys(self.heard, 0)
        self.offered = {name: [] for name in self.heard}
        log = SimpleNamespace(warning=self.said.append, info=self.said.append)
        node = SimpleNamespace(
            params=SimpleNamespace(sensor_silent_s=silent_s, lockstep=lockstep),
            relaxed=set(),
            get_logger=lambda: log,
            publishers_of=self.heard.get,
            taken_counts=lambda: dict(self.taken),
            doubled={}.get,
            get_publishers_info_by_topic=self.offered.get,
            get_topic_names_and_types=lambda: [
                (name, [i.topic_type]) for name, offers in self.offered.items() for i in offers
            ],
        )
        sources = [
            SimpleNamespace(
                role=role,
                stream=SimpleNamespace(type=kind),
                clock=None,
                **dict.fromkeys(('read', 'unreadable', 'empty', 'unsure', 'aloft'), 0),
            )
            for role, kind in TYPES.items()
        ]
        self.health = SourceHealth(node, sources, lambda s: f'/{s.role}', lambda: self.now_s)

    def look(self):
        self.health.look()
        return {c.sentence: c.culprit for c in self.health.conditions}


def test_what_is_heard_is_nothing_to_speak_of():
    rig = Rig()
    assert rig.look() == {}
    assert rig.health.diagnosed(Diagnosis()).level is Worst.OK


@pytest.mark.parametrize(
    ('offered', 'says'),
    [
        ([], 'nobody publishes /velocity'),
        ([offer('Odometry')], '/velocity is published as Odometry, not Twist'),
        (
            [offer('Twist')],
            'the QoS of /velocity is incompatible: its publisher offers best effort, volatile',
        ),
    ],
)
def test_a_source_that_cannot_be_heard_is_a_warning_with_its_sensor(offered, says):
    rig = Rig()
    rig.heard['/velocity'] = 0
    rig.offered['/velocity'] = offered
    assert rig.look() == {says: Culprit.DVL}
    [condition] = rig.health.conditions
    assert (condition.level, condition.key) == (Level.WARN, 'source /velocity')
    found = rig.health.diagnosed(Diagnosis())
    assert (found.level, found.message) == (Worst.WARN, f'running; {says}')
    rig.heard['/velocity'] = 1
    assert rig.look() == {}


def test_topics_of_the_type_that_was_missed_are_named():
    """A name without its slash, in another namespace, or misspelt."""
    rig = Rig()
    rig.heard['/position'] = 0
    # Estimates, its own and of others, are no measurements.
    rig.offered |= {f'/{v}/nav/fix': [offer('NavSatFix')] for v in ('auv', 'rov')}
    rig.offered |= {f'/{v}/nav/state': [offer(topics.TYPES[topics.STATE])] for v in ('auv', 'rov')}
    rig.offered['/other'] = [offer('Range')]
    assert list(rig.look()) == ['nobody publishes /position']
    rig.offered['/ugps/fix'] = [offer('NavSatFix')]
    says = 'nobody publishes /position (of its type there is /ugps/fix)'
    assert list(rig.look()) == [says]
    rig.offered |= {f'/gnss{k}': [offer('NavSatFix')] for k in range(9)}
    assert next(iter(rig.look())).endswith('there is /gnss0, /gnss1, /gnss2, ...)')


def test_each_role_has_its_culprit():
    rig = Rig()
    rig.heard.update(dict.fromkeys(rig.heard, 0))
    assert list(rig.look().values()) == [Culprit.IMU, Culprit.DVL, Culprit.DEPTH, Culprit.FIXES]


def test_a_sensor_whose_publisher_sends_nothing_is_named():
    """A driver that runs, and whose instrument is not plugged in."""
    rig = Rig(silent_s=30.0)
    rig.look()
    rig.now_s += 20.0
    rig.taken['/depth'] += 5
    assert rig.look() == {}
    rig.now_s += 11.0
    says = 'no message of /velocity for 31 s, though it has a publisher'
    # Fixes pause as they please, and the IMU's silence is told of by itself.
    assert rig.look() == {says: Culprit.DVL}
    rig.taken['/velocity'] += 1
    assert rig.look() == {}


def test_lockstep_has_no_pace_of_its_own():
    rig = Rig(lockstep=True)
    rig.look()
    rig.now_s += 1000.0
    assert rig.look() == {}


def test_the_log_has_what_stands_for_some_seconds_and_that_it_is_over():
    rig = Rig()
    rig.heard['/position'] = 0
    for _ in range(4):
        rig.look()
    assert rig.said == []
    for _ in range(4):
        rig.look()
    assert rig.said == ['nobody publishes /position']
    rig.heard['/position'] = 1
    rig.look()
    assert rig.said[1:] == ['/position is as the mapping file states it']
