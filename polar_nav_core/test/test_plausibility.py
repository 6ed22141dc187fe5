"""What a sensor cannot say is refused with the reason, and does no harm."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from closed_loop import World, gathered, inputs_of, run
from compiled import jit_only
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.engine import plausibility, refusals
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind, DepthSample, DvlPing, Fix, ImuSample
from polar_nav_core.engine.outputs import Receipt
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.start import place
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_core.error_model import X
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.identification.polar_fix import PolarFix

PARAMS = EngineParams()
STATION = EngineParams(mode='station')
NO_RATE, GRAVITY_B = np.zeros(3), np.array([0.0, 0.0, 9.83])
R = 0.01 * np.eye(3)


@pytest.fixture(scope='module')
def closed_world():
    return World(3.0)


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


@pytest.mark.parametrize('limit', [1.0, 6.0, 1e5])
@pytest.mark.parametrize('place', range(3))
def test_a_limit_holds_for_each_component_and_is_within_itself(limit, place):
    for value, good in (
        (limit, True),
        (-limit, True),
        (0.0, True),
        (math.nextafter(limit, math.inf), False),
        (math.nextafter(-limit, -math.inf), False),
        (math.inf, False),
        (-math.inf, False),
        (math.nan, False),
    ):
        values = np.zeros(3)
        values[place] = value
        assert plausibility.within(values, limit) == good
        rows = np.array([np.zeros(3), values, np.full(3, -limit)])
        assert plausibility.all_within(rows, limit).tolist() == [True, good, True]
    assert plausibility.all_within(np.zeros((0, 3)), limit).shape == (0,)


@pytest.mark.parametrize('place', range(3))
def test_a_variance_is_that_of_a_micrometre_to_1000_km(place):
    for sigma, good in ((1e-6, True), (1e6, True), (0.999e-6, False), (1.001e6, False)):
        variances = np.full(3, 4.0)
        variances[place] = sigma * sigma
        P = np.diag(variances)
        assert plausibility.is_covariance(P) == good
        assert plausibility.are_covariances(np.array([np.eye(3), P])).tolist() == [True, good]
        assert plausibility.is_variance(sigma * sigma) == good


@pytest.mark.parametrize(('i', 'j'), [(0, 1), (0, 2), (1, 2), (1, 0), (2, 0), (2, 1)])
def test_a_covariance_is_symmetric_but_for_rounding(i, j):
    sigmas = np.array([0.1, 2.0, 30.0])
    for difference, good in ((0.9e-6, True), (-0.9e-6, True), (1.1e-6, False), (-1.1e-6, False)):
        P = correlated(0.3, -0.2, 0.4)
        P[i, j] += difference
        P *= np.outer(sigmas, sigmas)
        assert plausibility.is_covariance(P) == good
        assert plausibility.are_covariances(P[None]).tolist() == [good]


@pytest.mark.parametrize('pair', range(3))
def test_a_correlation_of_one_is_none(pair):
    """The pivots of a covariance are above rounding: 1e-12 of what they would be uncorrelated."""
    for pivot, good in ((4e-12, True), (0.25e-12, False)):
        r = [0.0, 0.0, 0.0]
        r[pair] = -math.sqrt(1.0 - pivot)
        P = correlated(*r)
        assert plausibility.is_covariance(P) == good
        assert plausibility.are_covariances(P[None]).tolist() == [good]


def test_an_attitude_is_orthogonal_to_a_thousandth():
    c, s = math.cos(0.7), math.sin(0.7)
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for scale, good in ((1.0, True), (1.00045, True), (0.99955, True), (1.00055, False)):
        assert plausibility.is_attitude(scale * turned) == good
        assert plausibility.are_attitudes(scale * turned[None]).tolist() == [good]
    assert not plausibility.is_attitude(turned * (1.0 + 0.01 * np.eye(3)))
    sheared = turned + 0.002 * np.outer(turned[:, 0], [0.0, 1.0, 0.0])
    for axis in range(3):  # each pair of rows
        rolled = np.roll(sheared, axis, axis=0)
        assert not plausibility.is_attitude(rolled)
        assert plausibility.are_attitudes(np.array([turned, rolled])).tolist() == [1, 0]
    assert not plausibility.is_attitude(np.full((3, 3), np.nan))


@pytest.mark.parametrize(
    ('range_m', 'verdict'),
    [(1e6, None), (1e6 + 0.5, Verdict.IMPLAUSIBLE), (0.5, None), (0.0, Verdict.NOT_FINITE)],
)
def test_an_acoustic_range_is_at_most_1000_km(range_m, verdict):
    polar = PolarFix(
        station=np.zeros(3), station_heading=0.0, range=range_m, bearing=0.1,
        range_sigma=0.5, bearing_sigma=0.01, station_heading_sigma=0.01, sound_speed=1450.0,
    )  # fmt: skip
    found = refusals.unusable_fix(STATION, replace(FIX, polar=polar))
    assert (None if found is None else found[0]) is verdict


@pytest.mark.parametrize(
    ('distance', 'verdict'),
    [
        (6.3001e6, None),
        (6.4999e6, None),
        (6.2999e6, Verdict.IMPLAUSIBLE),
        (6.5001e6, Verdict.IMPLAUSIBLE),
    ],
)
def test_a_fix_lies_between_the_ocean_floor_and_orbits(distance, verdict):
    r_e = distance * np.array([0.6, 0.0, -0.8])
    found = refusals.unusable_fix(PARAMS, replace(FIX, r_e=r_e))
    assert (None if found is None else found[0]) is verdict


@pytest.mark.parametrize(('value', 'good'), [(-50.0, True), (-50.01, False)])
def test_a_depth_is_at_most_50_m_above_the_sea(value, good):
    assert (depth(value, 1.0) is None) == good


INITIAL = {
    'latitude': 'initial_latitude_deg',
    'longitude': 'initial_longitude_deg',
    'height': 'initial_height',
    'roll': 'initial_roll_deg',
    'pitch': 'initial_pitch_deg',
    'grid_heading': 'initial_grid_heading_deg',
    'sigma_position_horizontal': 'initial_sigma_position',
    'sigma_position_vertical': 'initial_sigma_height',
    'sigma_velocity': 'initial_sigma_velocity',
    'sigma_tilt': 'initial_sigma_tilt_deg',
    'sigma_heading': 'initial_sigma_heading_deg',
}
"""Values of an initial state, and the parameters that would state the same."""
LOWEST = {'sigma_tilt': 1e-9, 'sigma_heading': 1e-9}
"""A service may state what no parameter does [rad]."""


@pytest.mark.parametrize('name', INITIAL)
def test_an_initial_state_has_the_limits_of_its_parameters(name):
    declared = next(f.metadata for f in fields(EngineParams) if f.name == INITIAL[name])
    unit = math.pi / 180.0 if declared['unit'] == 'deg' else 1.0
    good = PARAMS.initial_state()
    low, high = LOWEST.get(name, declared['lo'] * unit), declared['hi'] * unit
    for value in (low, high, 0.5 * (low + high)):
        assert plausibility.initial_problem(replace(good, **{name: value})) == ''
    for value in (low - 1e-6 * abs(low), high + 1e-6 * high, math.nan, math.inf, -math.inf):
        assert name in plausibility.initial_problem(replace(good, **{name: value}))
    if name.startswith('sigma'):
        for value in (0.0, -1.0):
            problem = plausibility.initial_problem(replace(good, **{name: value}))
            assert problem == f'{name} is {value}: it must be positive'


@pytest.mark.parametrize('axis', range(3))
def test_an_initial_velocity_is_at_most_50_m_per_second(axis):
    for value, words in ((50.0, ''), (-50.0, ''), (50.1, 'lie in [-50, 50]'), (-50.1, 'v_G')):
        v_G = [0.0, 0.0, 0.0]
        v_G[axis] = value
        problem = plausibility.initial_problem(replace(PARAMS.initial_state(), v_G=tuple(v_G)))
        assert (problem == '') == (words == '')
        assert words in problem
        assert not words or f'v_G[{axis}]' in problem


@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_nothing_starts_where_there_is_no_grid_north(side):
    there = {'initial_latitude_deg': 0.0, 'initial_longitude_deg': 90.0 * side}
    with pytest.raises(ConfigError, match='grid north is undefined'):
        EngineParams(**there)
    EngineParams(initialize='service', **there)  # nobody reads them
    near = EngineParams(**(there | {'initial_latitude_deg': 1e-5})).initial_state()
    assert plausibility.initial_problem(near) == ''
    assert 'grid north' in plausibility.initial_problem(replace(near, latitude=0.0))


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
        ({'r_e': np.array([0.0, -6.378137e6, 0.0])}, Verdict.IMPLAUSIBLE),
        ({'r_e': np.array([0.09, 6.378137e6, 0.0])}, Verdict.IMPLAUSIBLE),
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
            {'latitude': 0.0, 'longitude': -0.5 * math.pi},
        ]
    ):
        state = replace(good, **change)
        command = Command(2 * 10**9, number, CommandKind.SET_INITIAL_STATE, state)
        (receipt,) = (r for r in engine.process(command) if isinstance(r, Receipt))
        assert receipt.verdict is Verdict.IMPLAUSIBLE
        assert next(iter(change)) in receipt.reason or 'grid north' in receipt.reason
        assert engine.navigating
    list(engine.process(Command(2 * 10**9, 99, CommandKind.SET_INITIAL_STATE, good)))
    assert not engine.navigating


def test_a_ping_is_no_better_than_the_best_ones():
    """One row after another as all at once; nothing changes where none states less."""
    honest = np.array([2.5e-5 * np.eye(3), 1e-6 * np.eye(3)])
    assert plausibility.widened_pings(honest, 5e-3) is honest
    stated = np.array([9e-12 * correlated(0.9, 0.0, 0.0), 2.5e-5 * np.eye(3)])
    stated[1, 2, 2] = 1e-7
    for sigma, variance in ((5e-3, 2.5e-5), (1e-4, 1e-6)):
        wider = plausibility.widened_pings(stated, sigma)
        assert np.allclose(np.diagonal(wider[0]), variance, rtol=1e-12)
        assert wider[0, 0, 1] == stated[0, 0, 1]
        assert np.allclose(np.diagonal(wider[1]), [2.5e-5, 2.5e-5, variance], rtol=1e-12)
        assert np.array_equal(plausibility.widened_pings(stated[0], sigma), wider[0])


def test_pings_that_are_too_sure_are_used_as_those_that_state_none_and_told(closed_world):
    def run(variance):
        engine = Engine(closed_world.params())
        pings = [replace(p, covariance_m=variance * np.eye(3)) for p in closed_world.dvl()]
        for event in sorted([*closed_world.imu(), *pings], key=lambda e: e.key):
            list(engine.process(event))
        told = {p.condition.key for p in engine.health.present}
        return engine.fusion.filter.state.P.tobytes(), 'dvl too sure' in told

    sure, told = run(1e-11)
    assert told
    usual, told = run(closed_world.params().dvl_sigma ** 2)
    assert not told
    assert abs(np.frombuffer(sure) - np.frombuffer(usual)).max() <= 1e-9


@jit_only
def test_a_whole_run_tells_of_pings_that_are_too_sure_for_a_minute():
    world = World(90.0)
    inputs = inputs_of(world, [])
    inputs.dvl_covariance_m[:5] = 1e-11 * np.eye(3)
    result = engine_run.run(world.params(), inputs, look_every_s=10.0)
    told = {
        round((look.stamp_ns - inputs.imu_stamps_ns[0]) * 1e-9)
        for look in result.health
        if 'dvl too sure' in {p.condition.key for p in look.present}
    }
    assert told
    assert max(told) <= 62


def a_fix(covariance_e, **changes):
    return replace(FIX, covariance_e=np.asarray(covariance_e, np.float64), **changes)


def horizontal(fix, east, north, along, up):
    """Covariance in ECEF axes of one in grid axes, variances [m^2], at the place of a fix."""
    C_e_G = ecef_to_grid(fix.r_e)
    P_G = np.array([[east, along, 0.0], [along, north, 0.0], [0.0, 0.0, up]])
    return C_e_G.T @ P_G @ C_e_G


@pytest.mark.parametrize('latitude', [80.0, -35.0])
def test_a_fix_is_no_better_than_the_best_ones_in_any_horizontal_direction(latitude):
    """10 m along the north-east, 0.1 m across it, and a height of depth sensors."""
    r_e = ecef_from_geodetic(math.radians(latitude), 0.3, -100.0)
    fix = replace(FIX, r_e=r_e)
    fix = replace(fix, covariance_e=horizontal(fix, 50.005, 50.005, 49.995, 0.0025))
    assert plausibility.believed(fix, 0.0999) is fix
    assert plausibility.believed(fix, 0.0) is fix
    wider = plausibility.believed(fix, 0.3)
    expected = horizontal(fix, 50.085, 50.085, 49.995, 0.0025)
    assert wider.covariance_e == pytest.approx(expected, abs=1.5e-3)
    assert np.array_equal(wider.stated_covariance_e, fix.covariance_e)
    least = plausibility.believed(replace(fix, covariance_e=1e-12 * np.eye(3)), 0.1)
    assert least.covariance_e == pytest.approx(horizontal(fix, 0.01, 0.01, 0.0, 1e-4), abs=1e-4)


def test_what_the_best_have_is_left_alone_to_rounding():
    for sigma in (0.1, 0.3):
        fix = a_fix(sigma**2 * np.eye(3))
        assert plausibility.believed(fix, sigma) is fix


def test_an_antenna_may_state_a_centimetre():
    fix = a_fix(1e-4 * np.eye(3), surface_depth=0.5)
    assert plausibility.believed(fix, 0.1) is fix
    wider = plausibility.believed(replace(fix, covariance_e=1e-6 * np.eye(3)), 0.1)
    assert wider.covariance_e == pytest.approx(1e-4 * np.eye(3), rel=1e-9, abs=1e-15)
    assert plausibility.believed(fix, 0.005) is fix


@jit_only
def test_fixes_that_are_too_sure_are_used_as_the_best_ones_and_told():
    """One after another as in a whole run."""
    world = World(60.0)
    fixes = world.fixes(3.0, 1.5, rng=np.random.default_rng(2))

    def run_with(sigma, up):
        stated = [replace(f, covariance_e=horizontal(f, *[sigma**2] * 2, 0.0, up)) for f in fixes]
        events = [*world.imu(), *world.dvl(), *stated]
        engine = Engine(world.params())
        receipts = [x for x in run(engine, events) if isinstance(x, Receipt)]
        whole = engine_run.run(world.params(), gathered(events), look_every_s=1.0)
        assert [str(r) for r in whole.receipts] == [str(r) for r in receipts]
        said = {p.condition.sentence for look in whole.health for p in look.present}
        told = {p.condition.sentence for p in engine.health.present}
        kept = [{s for s in sentences if 'state less' in s} for sentences in (said, told)]
        assert kept[0] == kept[1]
        return engine.fusion.filter.state.P.copy(), told & kept[1]

    sure, told = run_with(0.005, 2.5e-5)
    best, untold = run_with(0.1, 1e-4)
    assert told == {
        'fixes state less noise than 0.1 m, the best of their kind (min_fix_sigma): that is used'
    }
    assert not untold
    assert np.abs(sure - best).max() < 1e-3 * best[X.dr_e, X.dr_e].max()


def test_a_start_is_as_sure_as_its_fixes_are_believed():
    located = place.located(a_fix(1e-6 * np.eye(3)), 0.1)
    assert (located.sigma, located.sigma_up) == pytest.approx((0.1, 0.01))
