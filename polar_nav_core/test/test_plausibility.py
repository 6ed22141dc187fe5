"""What a sensor cannot say is refused with the reason, and does no harm."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_core.engine import plausibility, refusals
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import (
    Command,
    CommandKind,
    DepthSample,
    DvlPing,
    Fix,
    ImuSample,
    Receipt,
    Verdict,
)
from polar_nav_core.engine.params import EngineParams

PARAMS = EngineParams()
STATION = EngineParams(mode='station')
NO_RATE, GRAVITY_B = np.zeros(3), np.array([0.0, 0.0, 9.83])
R = 0.01 * np.eye(3)


def imu(omega, f, params=PARAMS):
    return refusals.unusable_local(params, ImuSample(1, 0, np.array(omega), np.array(f)), None)


def dvl(v_m, covariance_m):
    return refusals.unusable_local(PARAMS, DvlPing(1, 0, True, np.array(v_m), covariance_m), None)


def depth(value, variance):
    return refusals.unusable_local(PARAMS, DepthSample(1, 0, value, variance), None)


def correlated(xy, xz, yz):
    return np.array([[1.0, xy, xz], [xy, 1.0, yz], [xz, yz, 1.0]])


@pytest.mark.parametrize(
    ('refusal', 'verdict', 'words'),
    [
        (imu([0, 0, 30.0], GRAVITY_B), Verdict.IMPLAUSIBLE, '30 rad/s, max_rate is 6 rad/s'),
        (imu(NO_RATE, [0, 1e3, 9.8]), Verdict.IMPLAUSIBLE, '1000 m/s^2, max_specific_force'),
        (imu(NO_RATE, [0, 1e300, 9.8]), Verdict.IMPLAUSIBLE, '1e+300 m/s^2'),
        (imu(NO_RATE, [0, np.nan, 9.8]), Verdict.NOT_FINITE, 'not finite'),
        (imu([0, 1e6, np.nan], GRAVITY_B), Verdict.NOT_FINITE, 'not finite'),
        (dvl([1e300, 0, 0], R), Verdict.IMPLAUSIBLE, '1e+300 m/s, max_speed is 20 m/s'),
        (dvl([1, 0, np.inf], R), Verdict.NOT_FINITE, 'not finite'),
        (dvl([1, 0, 0], correlated(1, 1, -1)), Verdict.NOT_FINITE, 'not positive definite'),
        (dvl([1, 0, 0], correlated(0.9, 0.9, -0.9)), Verdict.NOT_FINITE, 'not positive definite'),
        (dvl([1, 0, 0], 5e-324 * np.eye(3)), Verdict.IMPLAUSIBLE, 'variance of the velocity is'),
        (dvl([1, 0, 0], 1e300 * np.eye(3)), Verdict.IMPLAUSIBLE, 'is 1e+300'),
        (dvl([1, 0, 0], -R), Verdict.NOT_FINITE, 'not positive'),
        (dvl([1, 0, 0], R + np.eye(3, k=1)), Verdict.NOT_FINITE, 'not positive definite'),
        (depth(1e160, 1e308), Verdict.IMPLAUSIBLE, 'variance of the depth is 1e+308'),
        (depth(1e160, 1.0), Verdict.IMPLAUSIBLE, 'a depth of 1e+160 m, max_depth is 12000 m'),
        (depth(100.0, 5e-324), Verdict.IMPLAUSIBLE, 'variance of the depth is'),
        (depth(np.nan, 1.0), Verdict.NOT_FINITE, 'not finite'),
        (depth(100.0, 0.0), Verdict.NOT_FINITE, 'not positive'),
    ],
)
def test_refused_with_the_reason(refusal, verdict, words):
    assert refusal is not None
    assert refusal[0] is verdict
    assert words in refusal[1]


@pytest.mark.parametrize(
    'refusal',
    [
        imu([1.0, -2.0, 0.5], [20.0, -5.0, 30.0]),
        dvl([19.0, 0, 0], R),
        dvl([1, 0, 0], correlated(0.9, 0.9, 0.9)),
        dvl([1, 0, 0], 1e-10 * correlated(-0.9, 0.1, 0.2)),
        depth(-2.0, 1e-4),
        depth(11000.0, 1e6),
    ],
)
def test_what_sensors_do_say_is_used(refusal):
    assert refusal is None


def test_an_attitude_must_be_a_rotation():
    for C_b_G in (np.zeros((3, 3)), 2.0 * np.eye(3), 1e300 * np.eye(3)):
        sample = ImuSample(1, 0, NO_RATE, NO_RATE, C_b_G)
        found = refusals.unusable_local(STATION, sample, None)
        assert found == (Verdict.IMPLAUSIBLE, 'the attitude is no rotation')


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    st.lists(st.floats(1e-5, 1e5), min_size=3, max_size=3),
)
def test_definite_means_what_eigenvalues_say(r, sigmas):
    P = correlated(*r) * np.outer(sigmas, sigmas)
    least = np.linalg.eigvalsh(correlated(*r))[0]
    if abs(least) > 1e-6:
        assert plausibility.is_covariance(P) == (least > 0.0)
    assert plausibility.is_covariance(P) == plausibility.are_covariances(P[None])[0]


def started():
    engine = Engine(PARAMS)
    list(engine.process(ImuSample(10**9, 0, NO_RATE, GRAVITY_B)))
    return engine


FIX = Fix(
    validity_ns=10**9, transmit_ns=10**9, receive_ns=2 * 10**9, source='leader', sequence=1,
    order=1, arrival=0, r_e=np.array([0.0, 0.0, 6.35e6]), covariance_e=np.eye(3),
)  # fmt: skip


@pytest.mark.parametrize(
    ('change', 'verdict'),
    [
        ({'covariance_e': correlated(1.0, 1.0, -1.0)}, Verdict.NOT_FINITE),
        ({'covariance_e': 1e-320 * np.eye(3)}, Verdict.IMPLAUSIBLE),
        ({'r_e': np.array([1e300, 0.0, 0.0])}, Verdict.IMPLAUSIBLE),
        ({'r_e': np.zeros(3)}, Verdict.IMPLAUSIBLE),
        ({'relative_e': np.full(3, np.nan)}, Verdict.NOT_FINITE),
    ],
)
def test_a_fix_that_is_none_leaves_navigation_alone(change, verdict):
    engine = started()
    (receipt,) = (r for r in engine.process(replace(FIX, **change)) if isinstance(r, Receipt))
    assert receipt.verdict is verdict
    assert engine.navigating


def test_an_absurd_initial_state_is_refused_and_navigation_goes_on():
    engine, good = started(), PARAMS.initial_state()
    assert good is not None
    for number, change in enumerate(
        [
            {'height': 1e300},
            {'longitude': 1e300},
            {'grid_heading': 1e300},
            {'v_G': (1e300, 0.0, 0.0)},
            {'sigma_heading': 1e200},
            {'sigma_position_horizontal': 1e300},
            {'sigma_velocity': 0.0},
            {'roll': float('nan')},
        ]
    ):
        state = replace(good, **change)
        command = Command(2 * 10**9, number, CommandKind.SET_INITIAL_STATE, state)
        (receipt,) = (r for r in engine.process(command) if isinstance(r, Receipt))
        assert receipt.verdict is Verdict.IMPLAUSIBLE
        assert next(iter(change)) in receipt.reason
        assert engine.navigating
    list(engine.process(Command(2 * 10**9, 99, CommandKind.SET_INITIAL_STATE, good)))
    assert not engine.navigating
