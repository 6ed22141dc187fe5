"""Gravity that is not normal and a sea that is not level: what the truth makes of them."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sim_chances import inside

from polar_nav_core import earth, grid
from polar_nav_core.errors import ConfigError
from polar_nav_sim.environment import ARCSEC, MGAL, Geoid, GeoidSpec, Gravity, GravitySpec
from polar_nav_sim.mission import load_mission
from polar_nav_sim.sound_speed import SoundSpeed

ORIGIN_E = np.asarray(earth.ecef_from_geodetic(math.radians(86.0), 1.0, -100.0))
SEEDS = 400
VARYING = GravitySpec(anomaly_sigma_mgal=20.0, deflection_sigma_arcsec=6.0)


def block_of(mission, vehicle='follower', seconds=20.0):
    mission = mission.with_duration(seconds)
    return mission.truth(vehicle).samples(0, mission.sample_count)


@pytest.mark.parametrize('away_m', [0.0, 7e3])
def test_gravity_over_seeds_has_the_stated_sigmas(away_m):
    place_e = ORIGIN_E + np.array([away_m, 0.0, 0.0])
    g = np.array(
        [
            Gravity(dataclasses.replace(VARYING, seed=k), ORIGIN_E).disturbance(place_e)
            for k in range(SEEDS)
        ]
    )
    tilt = 6.0 * ARCSEC * float(earth.gravity(place_e))
    assert inside(g, [tilt, tilt, 20.0 * MGAL])
    assert np.abs(g.mean(axis=0) / g.std(axis=0)).max() < 4.0 / math.sqrt(SEEDS)


def test_gravity_is_smooth_over_its_waves_and_repeats():
    gravity = Gravity(VARYING, ORIGIN_E)
    along_e = ORIGIN_E + np.linspace(0.0, 500.0, 51)[:, None] * [1.0, 0.0, 0.0]
    g = gravity.disturbance(along_e)
    # The steepest wave is 10 km long: at most 2 pi sqrt(2 K) sigma / 10 km along the way.
    most = 2.0 * np.pi / 10e3 * math.sqrt(32.0) * 20.0 * MGAL
    assert np.abs(np.diff(g[:, 2])).max() < 10.0 * most
    assert_array_equal(g, Gravity(VARYING, ORIGIN_E).disturbance(along_e))


def test_anomaly_and_deflection_belong_to_one_potential():
    # Horizontally a potential field has no curl.
    gravity = Gravity(GravitySpec(deflection_sigma_arcsec=6.0), ORIGIN_E)
    axes = np.asarray(grid.ecef_to_grid(ORIGIN_E))[:2]
    step = 10.0
    d = [
        (gravity.disturbance(ORIGIN_E + step * a) - gravity.disturbance(ORIGIN_E - step * a))
        for a in axes
    ]
    assert_allclose(d[0][1], d[1][0], rtol=1e-2, atol=1e-4 * np.abs(d).max())


@pytest.mark.parametrize('name', ['demo', 'near_pole', 'model_aided', 'station'])
def test_only_the_specific_force_feels_it(name):
    mission = load_mission(name)
    vehicle = mission.followers[0]
    plain = block_of(mission, vehicle, 3.0)
    other = block_of(
        mission.with_overrides({'gravity': {'anomaly_mgal': 30, 'deflection_arcsec': [10, -5]}}),
        vehicle,
        3.0,
    )
    for field in ('r_e', 'v_G', 'C_b_G', 'omega_ib_b', 'depth'):
        assert_array_equal(getattr(plain.state, field), getattr(other.state, field))
    # Stronger gravity downwards is held up by more force upwards.
    df_G = np.einsum('nij,nj->ni', plain.state.C_b_G, other.state.f_b - plain.state.f_b)
    g = float(earth.gravity(plain.state.r_e[0]))
    expected = [-10.0 * ARCSEC * g, 5.0 * ARCSEC * g, 30.0 * MGAL]
    assert_allclose(df_G, np.tile(expected, (len(df_G), 1)), rtol=1e-5, atol=1e-12)
    dv = other.delta_v_b[1:] - plain.delta_v_b[1:]
    assert_allclose(np.linalg.norm(dv, axis=1), 0.01 * np.linalg.norm(expected), rtol=1e-5)


def test_leader_and_follower_meet_the_same_field():
    mission = load_mission('near_pole').with_overrides({'gravity': {'anomaly_sigma_mgal': 20.0}})
    fields = [mission.truth(v)._environment.gravity for v in mission.vehicles]
    assert fields[0] is fields[1]
    assert np.abs(fields[0].disturbance(ORIGIN_E)[2]) > 0.0


def test_geoid_moves_the_surface_and_not_the_vehicle():
    mission = load_mission('demo')
    plain = block_of(mission).state
    other = block_of(mission.with_overrides({'geoid': {'undulation_m': 2}})).state
    assert_array_equal(plain.r_e, other.r_e)
    assert_allclose(other.depth - plain.depth, 2.0, atol=1e-9)
    n = [
        Geoid(GeoidSpec(undulation_sigma_m=1.5, seed=k), ORIGIN_E).undulation(ORIGIN_E)
        for k in range(SEEDS)
    ]
    assert inside(np.array(n)[:, None], 1.5)


def test_pose_and_state_of_a_vehicle_with_dynamics_agree_on_depth():
    mission = load_mission('model_aided').with_overrides({'geoid': {'undulation_m': 2.0}})
    truth = mission.with_duration(3.0).truth('follower')
    t_ns = mission.start_ns + 10**9
    assert truth.pose(t_ns).depth == pytest.approx(float(truth.state(t_ns).depth), abs=1e-6)


def test_floor_in_range_or_assumed():
    mission = load_mission('demo').with_overrides({'sea_floor_depth_m': 3000.0})
    deep = mission.with_overrides({'bottom_lock': 'range'})
    assert_allclose(block_of(deep).state.altitude, 2900.0, atol=1e-5)
    assumed = mission.with_overrides({'bottom_lock': 'assumed'})
    assert np.isnan(block_of(assumed).state.altitude).all()
    # What a DVL can reach needs no assumption.
    shallow = assumed.with_overrides({'sea_floor_depth_m': 180.0})
    assert_allclose(block_of(shallow).state.altitude, 80.0, atol=1e-5)


def test_water_of_a_mission():
    demo = load_mission('demo')
    assert demo.with_overrides({'sound_speed': 1480}).water.sound_speed == 1480.0
    cast = demo.with_overrides({'sound_speed_profile': 'arctic_ssp/sizrs_2016_october6_drop6.csv'})
    assert 1430.0 < SoundSpeed.from_spec(cast.water).at(50.0) < 1460.0


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'gravity.anomaly': 3.0}, ('gravity', 'anomaly')),
        ({'gravity.anomaly_mgal': 1e4}, ('anomaly_mgal', '500')),
        ({'gravity': 3.0}, ('gravity', 'mapping')),
        ({'geoid.undulation': 3.0}, ('geoid', 'undulation')),
        ({'bottom_lock': 'always'}, ('bottom_lock', 'always', 'assumed')),
        ({'sound_speed': 900.0}, ('sound_speed', '900')),
        ({'sound_speed_profile': 'nothing.csv'}, ('nothing.csv',)),
        ({'sound_speed_profil': 'nothing.csv'}, ('sound_speed_profil',)),
    ],
)
def test_mistakes_are_named(change, words):
    with pytest.raises(ConfigError) as error:
        load_mission('demo').with_overrides(change)
    for word in ('demo.yaml', *words):
        assert word in str(error.value)
