"""Silence of the IMU is an error, by a steady clock that raises nothing else."""

import logging
from dataclasses import replace

import numpy as np

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import ImuSample
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_ros.diagnostics import Level
from polar_nav_ros.navigation_health import NavigationHealth

START_NS = 10**12


def imu(k, stamp_ns=None):
    """Sample number k of a vehicle at rest, 100 Hz."""
    stamp_ns = START_NS + k * 10**7 if stamp_ns is None else stamp_ns
    return ImuSample(stamp_ns, k, np.zeros(3), np.array([0.0, 0.0, 9.83]))


def watched():
    """An engine with a state, its health, and the steady time that the health sees."""
    engine, now = Engine(EngineParams()), [0.0]
    health = NavigationHealth(engine, logging.getLogger('test'), lambda: now[0])
    for k in range(3):
        list(engine.process(imu(k)))
    health.diagnose({'waiting': 3})
    return engine, health, now


def test_silence_of_the_imu_while_others_wait_is_an_error():
    engine, health, now = watched()
    now[0] = 2.0
    assert health.diagnose({'waiting': 8}).level is Level.OK
    now[0] = 4.0
    found = health.diagnose({'waiting': 20})
    assert found.level is Level.ERROR
    assert found.message == 'no IMU sample for 4 s while other sensors go on'
    list(engine.process(imu(3)))
    assert health.diagnose({'waiting': 1}).level is Level.OK


def test_nothing_at_all_is_no_silence_of_the_imu():
    _, health, now = watched()
    now[0] = 60.0
    assert health.diagnose({'waiting': 3}).level is Level.OK


def test_stamps_that_step_back_are_an_error_until_they_have_caught_up():
    engine, health, _ = watched()
    for k in range(5):
        engine.refuse(imu(k, START_NS - 10**10), Verdict.TOO_LATE, 'late', START_NS)
    found = health.diagnose({})
    assert found.level is Level.ERROR
    assert 'IMU stamps are 10.0 s behind the newest' in found.message
    list(engine.process(imu(3)))
    assert health.diagnose({}).level is Level.OK


def test_what_is_refused_is_named_beside_a_warning_that_stays(monkeypatch):
    """A slow vehicle's DVL is a WARN all the time; that no fix is used must not hide there."""
    engine, health, _ = watched()
    engine.verdicts[Verdict.FROM_FUTURE] += 2
    monkeypatch.setattr(Engine, 'history_warning', 'sensors outrun the history')
    found = health.diagnose({})
    assert found.level is Level.WARN
    assert found.message == 'sensors outrun the history; 2 messages were stamped ahead'
    assert health.diagnose({}).message == 'sensors outrun the history'


def test_another_sentence_at_the_same_level_is_logged_once_a_minute(monkeypatch, caplog):
    """A log that says one WARN, and nothing of those that came after it, misleads on deck."""
    engine, health, now = watched()
    monkeypatch.setattr(Engine, 'history_warning', 'sensors outrun 3 s')
    caplog.set_level(logging.INFO)
    for second in range(130):
        now[0] = 1.0 + second
        sample = imu(3 + second)
        list(engine.process(replace(sample, f_b=sample.f_b + 1e-6 * second)))
        engine.verdicts[Verdict.FROM_FUTURE] += second > 20
        health.diagnose({})
    assert caplog.messages == [
        'sensors outrun 3 s',
        '1 messages were stamped ahead',
        'sensors outrun 3 s',
        '62 messages were stamped ahead',
        'sensors outrun 3 s',
    ]


def test_what_is_refused_for_its_numbers_is_a_warning_while_it_goes_on():
    engine, health, _ = watched()
    list(engine.process(ImuSample(START_NS + 3 * 10**7, 3, np.zeros(3), np.full(3, 1e6))))
    found = health.diagnose({})
    assert (found.level, found.message[:10]) == (Level.WARN, '1 messages')
    assert health.diagnose({}).level is Level.OK
