"""An IMU away from base_link: estimates are those of one at base_link, covariance included."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_worlds import (
    DVL_LEVER_B,
    GYRO_NOISE,
    ROOT,
    Recorder,
    aiding_columns,
    imu_column,
    imu_means,
    mapping,
    point,
    stamps_of,
    truth_of,
    write_columns,
)

from polar_nav_core.attitude import exp, skew
from polar_nav_core.earth import ecef_from_geodetic
from polar_nav_core.engine.lever import Rates
from polar_nav_core.engine.track import Track
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.strapdown import Strapdown
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.section import Section
from polar_nav_tools.bags.arrays import estimates_from_cdr
from polar_nav_tools.foreign.lever import from_imu
from polar_nav_tools.foreign.replay import ForeignRun, replay
from polar_nav_tools.foreign.sources import open_source
from polar_nav_tools.smoothing.bag import How, SmoothedRun, smooth_mapped, stated_sigma

LEVER_B = (1.2, -0.2, 0.3)
BOW = f'{ROOT}/bow/imu'
DURATION_S = 300.0
S = 1_000_000_000


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two IMUs of equal errors, one at base_link and one in the bow."""
    truth, make = truth_of(DURATION_S), Recorder()
    stamps = stamps_of(truth, 0.0, DURATION_S, 0.01)
    columns = [
        imu_column(make, truth, stamps),
        imu_column(make, truth, stamps, topic=BOW, lever_b=LEVER_B),
        *aiding_columns(make, truth, 0.0, DURATION_S),
    ]
    return write_columns(tmp_path_factory.mktemp('lever') / 'bag', make, columns)


def run(bag: Path, imu: dict[str, Any], *, messages: bool = False) -> ForeignRun:
    """Replay with one of the IMUs."""
    what = mapping_file.from_section(Section('m', mapping(imu)))
    return replay(open_source(bag), what, messages=messages)


def errors(done: ForeignRun) -> tuple[float, float]:
    """RMS of position [m] and velocity [m/s], of the three axes together."""
    e = done.estimates
    s = truth_of(DURATION_S).state(e.stamp_ns)
    return tuple(
        float(np.sqrt(np.mean(np.sum(d**2, axis=1)))) for d in (e.r_e - s.r_e, e.v_G - s.v_G)
    )


@pytest.mark.slow
def test_the_samples_in_the_bow_are_those_of_the_bow() -> None:
    """The core's strapdown carries the bow's own position along to a millimetre, unaided."""
    truth = truth_of(DURATION_S)
    stamps = stamps_of(truth, 0.0, DURATION_S, 0.01)
    omega, f = imu_means(truth, stamps, np.array(LEVER_B))
    first, last = truth.state(stamps[:1] - S // 100), truth.state(stamps[-1:])
    r_e, v_G = (x[0] for x in point(first, LEVER_B))
    turn = ecef_to_grid(r_e) @ first.C_e_G[0].T  # grid axes at the bow
    ins = Strapdown(turn @ first.C_b_G[0], turn @ v_G, r_e)
    ins.run(omega * 0.01, f * 0.01, 0.01)
    r_end, v_end = point(last, LEVER_B)
    assert np.linalg.norm(ins.r_e - r_end[0]) < 1e-3
    assert np.abs(ins.v_G - v_end[0]).max() < 1e-5


@pytest.mark.slow
def test_an_imu_in_the_bow_is_as_good_as_one_at_base_link(bag: Path) -> None:
    """The same errors to what is left, which can be stated.

    The engine takes the DVL's lever arm with the mean rate of the last 10 ms, 5 ms late: with
    0.2 rad/s^2 and 1.25 m that is 1.3 mm/s at most. The rate that moves velocity back, carried on
    from two means, has noise of ``2.9e-5 sqrt(2.5 / 0.01 s)`` rad/s, on 1.25 m 0.57 mm/s, which is
    stated in the covariance. Of position a twentieth of its stated sigma.
    """
    base = run(bag, {})
    bow = run(bag, {'topic': BOW, 'lever_b': list(LEVER_B)}, messages=True)
    assert bow.verdicts == base.verdicts == {'FUSED': 15}
    a, b = base.estimates, bow.estimates
    assert np.array_equal(a.stamp_ns, b.stamp_ns)
    assert np.abs(a.v_G - b.v_G).max() < 1.3e-3 + 5.0 * 0.26e-3
    sigma = np.sqrt(np.diagonal(a.P_position_G, axis1=1, axis2=2))
    assert np.linalg.norm(a.r_e - b.r_e, axis=1).max() < 0.05 * sigma.max(axis=1).min()
    noise = GYRO_NOISE * np.sqrt(2.5 / 0.01) * (b.C_b_G @ skew(np.array(LEVER_B)))
    for name in ('P_position_G', 'P_velocity_G', 'P_attitude_G'):
        ours, theirs = (np.diagonal(getattr(x, name), axis1=1, axis2=2)[10:] for x in (b, a))
        if name == 'P_velocity_G':
            ours = ours - np.sum(noise**2, axis=2)[10:]
        assert np.abs(np.sqrt(ours / theirs) - 1.0).max() < 0.03
    assert errors(bow) == pytest.approx(errors(base), rel=0.05)
    # What is written says the same as what is scored.
    messages = estimates_from_cdr([row[2] for row in bow.states], 'auv')
    assert np.array_equal(messages.r_e, b.r_e)
    assert np.array_equal(messages.P_velocity_G, b.P_velocity_G)
    # Parameters are told as they were stated, from base_link.
    assert bow.loaded.params.dvl_lever_b == DVL_LEVER_B


@pytest.mark.slow
def test_a_smoothed_imu_in_the_bow_is_as_good_as_one_at_base_link(bag: Path) -> None:
    def smoothed(imu: dict[str, Any]) -> SmoothedRun:
        what = mapping_file.from_section(Section('m', mapping(imu)))
        return smooth_mapped(open_source(bag), what, accept=(), how=How(), progress=lambda _: None)

    base, bow = smoothed({}), smoothed({'topic': BOW, 'lever_b': list(LEVER_B)})
    a, b = base.smoothed, bow.smoothed
    assert np.array_equal(a.stamp_ns, b.stamp_ns)
    sigma = np.sqrt(np.diagonal(a.P_position_G, axis1=1, axis2=2))
    assert np.linalg.norm(a.r_e - b.r_e, axis=1).max() < 0.1 * sigma.max(axis=1).min()
    assert np.abs(a.v_G - b.v_G).max() < 3e-3
    ours, theirs = (np.diagonal(x.P_position_G, axis1=1, axis2=2) for x in (b, a))
    assert np.abs(np.sqrt(ours / theirs) - 1.0).max() < 0.03
    assert stated_sigma(b) < stated_sigma(bow.filtered)


@pytest.mark.slow
@pytest.mark.parametrize('lever_b', [(0.0, 0.0, 0.0), (-1.2, 0.2, -0.3), (1.2, 0.2, 0.3)])
def test_a_wrong_lever_arm_shows(bag: Path, lever_b: tuple[float, ...]) -> None:
    """Not stated, the wrong way round, y to the wrong side: clearly worse."""
    good = errors(run(bag, {'topic': BOW, 'lever_b': list(LEVER_B)}))
    bad = errors(run(bag, {'topic': BOW, 'lever_b': list(lever_b)}))
    assert bad[1] > 3.0 * good[1]


def state() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Attitude, position, corrected rate and gyro bias somewhere."""
    r_e = np.array([5.0e5, -3.0e5, 6.33e6])
    C_b_G = exp(np.array([0.1, -0.2, 0.9]))
    return C_b_G, r_e, np.array([0.11, -0.07, 0.2]), np.array([1e-3, -2e-3, 3e-3])


def track_of(C_b_G: np.ndarray, bias: np.ndarray, P: np.ndarray) -> Track:
    """One estimate."""
    _, r_e, _, _ = state()
    return Track(
        np.array([2 * S], dtype=np.int64),
        r_e[None],
        np.array([[1.5, -0.5, 0.1]]),
        C_b_G[None],
        P[None],
        np.r_[bias, np.zeros(12)][None],
        np.zeros((1, 2, 3)),
        np.zeros((1, 3), dtype=np.int64),
    )


def rates(*, mean: bool = True) -> Rates:
    """The same rate from 1 s to 3 s."""
    stamps = np.arange(100, 301, dtype=np.int64) * (S // 100)
    return Rates(stamps, np.tile(state()[2] + state()[3], (len(stamps), 1)), mean)


def test_covariance_follows_the_estimate() -> None:
    """Against differences of the moved estimate itself: another attitude, another bias."""
    C_b_G, _, _, bias = state()
    lever = np.array(LEVER_B)

    def moved(error: np.ndarray) -> np.ndarray:
        """Velocity and position of base_link when the errors of phi and b_gyro are these."""
        # b_gyro is what is left after the correction: the estimate of the bias lacks it.
        wrong = track_of(exp(-error[:3]) @ C_b_G, bias - error[3:], np.zeros((24, 24)))
        out = wrong.at_base_link(lever, rates(), 0.0)
        return np.r_[out.v_G[0], out.r_e[0]]

    step = 1e-4
    J = np.eye(24)
    for i, column in enumerate([0, 1, 2, 9, 10, 11]):
        e = np.zeros(6)
        e[i] = step
        J[3:9, column] = (moved(e) - moved(-e)) / (2.0 * step)
    rng = np.random.default_rng(5)
    half = rng.normal(size=(24, 24)) * np.r_[np.full(3, 0.01), np.full(21, 0.1)][:, None]
    P = half @ half.T
    found = track_of(C_b_G, bias, P).at_base_link(lever, rates(), 0.0).P[0]
    # Positions of 6e6 m differ by 1e-9 m at best, over the step 1e-5.
    assert np.abs(found - J @ P @ J.T).max() < 1e-4 * np.abs(P).max()
    assert np.abs(found - P).max() > 1e-2 * np.abs(P).max()


def test_noise_of_the_rate_is_in_the_velocity() -> None:
    """Of a lever along x nothing along x; what is carried on has 1.5^2 + 0.5^2 of one sample."""
    C_b_G, _, _, bias = state()
    track = track_of(C_b_G, bias, np.zeros((24, 24)))
    P = track.at_base_link(np.array([2.0, 0.0, 0.0]), rates(), GYRO_NOISE).P[0]
    P_b = C_b_G.T @ P[3:6, 3:6] @ C_b_G
    expected = (2.0 * GYRO_NOISE) ** 2 / 0.01 * np.diag([0.0, 2.5, 2.5])
    assert np.allclose(P_b, expected, rtol=1e-9, atol=1e-18)
    P[3:6, 3:6] = 0.0
    assert not P.any()


def test_rates_at_the_stamps() -> None:
    """Means of a rate that grows steadily give it back, by what came before; not over a gap."""
    stamps = np.array([100, 110, 120, 145, 155, 655], dtype=np.int64) * (S // 1000)
    starts = np.r_[90, 100, 110, 120, 145, 155] * 1e-3
    middle = 0.5 * (starts + stamps * 1e-9)
    slope = np.array([1.0, -2.0, 0.5])
    means = Rates(stamps, middle[:, None] * slope, mean=True)
    omega, bandwidth = means.at(stamps)
    assert np.allclose(omega[2:5], stamps[2:5, None] * 1e-9 * slope)
    for k in (0, 1, 5):  # nothing before it whose interval is known, or a gap
        assert np.array_equal(omega[k], means.omega_ib_b[k])
    assert bandwidth[2] == pytest.approx(250.0)
    assert bandwidth[0] == 1.0
    assert bandwidth[5] == pytest.approx(2.0)
    # Sample after sample: the same bits.
    for k in range(1, len(stamps) + 1):
        some = Rates(stamps[max(0, k - 3) : k], means.omega_ib_b[max(0, k - 3) : k], mean=True)
        one, its = some.at(stamps[k - 1 : k])
        assert np.array_equal(one[0], omega[k - 1])
        assert its[0] == bandwidth[k - 1]
    instant, _ = Rates(stamps, means.omega_ib_b, mean=False).at(stamps)
    assert np.array_equal(instant, means.omega_ib_b)


def test_what_does_not_go_with_it_is_refused() -> None:
    """The model of the vehicle, and sensors further apart than a ship is long."""
    lever = np.array([60.0, 0.0, 0.0])
    with pytest.raises(ConfigError, match=r'dvl_lever_b \[-50\.0, .* 110 m from it'):
        from_imu(FollowerParams(dvl_lever_b=(-50.0, 0.0, 0.0)), lever, np.zeros(3))
    with pytest.raises(ConfigError, match='lever_b does not go with parameter model_aiding'):
        from_imu(FollowerParams(model_aiding=True), lever, np.zeros(3))
    with pytest.raises(ConfigError, match='lever_b does not go with parameter mode station'):
        from_imu(FollowerParams(mode='station', configuration='default'), lever, np.zeros(3))


def test_the_start_is_moved_to_the_imu() -> None:
    """A metre forward, heading 30 degrees; while the vehicle turns, the IMU is faster."""
    params = FollowerParams(
        initial_latitude_deg=89.9,
        initial_longitude_deg=30.0,
        initial_height=-50.0,
        initial_grid_heading_deg=30.0,
        initial_v_G=(0.5, 0.0, 0.0),
        depth_lever_b=(0.1, 0.2, 0.3),
    )
    there = from_imu(params, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.2]))
    initial = [p.initial_state() for p in (params, there)]
    assert initial[0] is not None
    assert initial[1] is not None
    r_base, r_imu = (
        np.asarray(ecef_from_geodetic(s.latitude, s.longitude, s.height))
        for s in initial
        if s is not None
    )
    moved_G = ecef_to_grid(r_base) @ (r_imu - r_base)
    assert moved_G == pytest.approx([0.5, np.sqrt(0.75), 0.0], abs=1e-6)
    # 0.2 rad/s to port: a metre ahead goes to port, which is (-cos 30, sin 30) here. The earth
    # turns 7e-5 rad/s of it.
    expected = np.array([0.5 - 0.2 * np.sqrt(0.75), 0.1, 0.0])
    assert np.abs(np.array(there.initial_v_G) - expected).max() < 1e-4
    assert there.depth_lever_b == pytest.approx((-0.9, 0.2, 0.3))
