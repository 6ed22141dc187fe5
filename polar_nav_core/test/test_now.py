"""The state at the newest sample: the engine's own later, smooth over corrections; jumps count."""

from dataclasses import replace

import numpy as np
import pytest
from closed_loop import World

from polar_nav_core import attitude, earth, grid
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind, ImuSample, InitialState
from polar_nav_core.engine.now import Predictor
from polar_nav_core.engine.reorder import Reorder
from polar_nav_core.error_model import X
from polar_nav_core.output_params import OutputParams

WINDOW_S = 0.05


@pytest.fixture(scope='module')
def world():
    return World(18.0)


class Rig:
    """A live engine with its predictor; every sample is followed by a prediction."""

    def __init__(self, world, window_s=WINDOW_S, shape=None, lever_b=(0.0, 0.0, 0.0), **changes):
        self.params = world.params(reorder_window_s=window_s, **changes)
        engine = Engine(self.params, imu_lever_b=lever_b)
        self.reorder = Reorder(engine, window_s, 0.25)
        self.predictor = Predictor(self.params, OutputParams(**(shape or {})))
        self.found = []
        self.later = {}

    def feed(self, events):
        for event in events:
            list(self.reorder.add(event))
            engine = self.reorder.engine
            if engine.fusion is not None:
                s = engine.fusion.filter.state
                self.later[engine.fusion.stamp_ns] = s.r_e.copy(), s.v_G.copy(), s.C_b_G.copy()
            if isinstance(event, ImuSample):
                now = self.predictor.update(engine, self.reorder.waiting_imu())
                if now is not None:
                    self.found.append(now)
        return self.found


def as_they_come(events):
    return sorted(events, key=lambda e: e.key)


@pytest.mark.parametrize('window_s', [0.0, 0.05, 2.0])
@pytest.mark.parametrize('imu_sample', ['mean', 'instant'])
def test_without_a_correction_it_is_what_the_engine_has_later(world, window_s, imu_sample):
    rig = Rig(world, window_s, imu_sample=imu_sample)
    found = rig.feed(world.imu())
    compared = 0
    for now in found:
        if now.stamp_ns in rig.later:
            r_e, v_G, C_b_G = rig.later[now.stamp_ns]
            np.testing.assert_allclose(now.r_e, r_e, rtol=0, atol=1e-9)
            np.testing.assert_allclose(now.v_G, v_G, rtol=0, atol=1e-12)
            np.testing.assert_allclose(now.C_b_G, C_b_G, rtol=0, atol=1e-14)
            compared += 1
    assert compared > 1000
    assert found[-1].stamp_ns == world.stamps[-1]
    assert found[-1].jumps == 0


@pytest.mark.parametrize('window_s', [0.0, 0.05])
def test_of_an_imu_in_the_bow_it_is_the_state_of_base_link(world, window_s):
    lever_b = np.array([1.2, -0.2, 0.3])
    sigmas = {'initial_sigma_position': 0.02, 'initial_sigma_heading_deg': 5.0}
    rig = Rig(world, window_s, lever_b=lever_b, **sigmas)
    found = rig.feed(world.imu())
    compared = 0
    for now in found:
        if now.stamp_ns in rig.later:
            r_e, v_G, C_b_G = rig.later[now.stamp_ns]
            there = r_e - grid.ecef_to_grid(r_e).T @ C_b_G @ lever_b
            np.testing.assert_allclose(now.r_e, there, rtol=0, atol=2e-9)
            v_base = v_G - C_b_G @ np.cross(now.omega_eb_b, lever_b)
            np.testing.assert_allclose(now.v_G, v_base, rtol=0, atol=1e-12)
            assert now.height == pytest.approx(earth.geodetic_from_ecef(there)[2], abs=1e-6)
            compared += 1
    assert compared > 1000
    # Without corrections, what it moves by is what it has moved by.
    way = np.sum([now.moved_e for now in found[1:]], axis=0)
    np.testing.assert_allclose(way, found[-1].r_e - found[0].r_e, rtol=0, atol=1e-7)
    # Its covariance is that of base_link: of another point's by far more than the time ahead.
    engine = rig.reorder.engine
    P, own = rig.predictor.covariance(engine), engine.fusion.filter.published_P
    moved = engine.arm.moved(engine.fusion.estimate((0, 0, 0))).P
    sigma, of_imu, of_base = (np.sqrt(np.diagonal(x)[6:9]) for x in (P, own, moved))
    assert np.abs(sigma - of_base).max() < 0.2 * np.abs(of_imu - of_base).max()


def test_it_stands_at_the_newest_sample_and_near_the_truth(world):
    events = as_they_come([*world.imu(), *world.dvl(), *world.depth()])
    found = Rig(world).feed(events)
    assert [now.stamp_ns for now in found[-900:]] == list(world.stamps[-900:])
    for now in found[::50]:
        k = int((now.stamp_ns - world.stamps[0]) // 10_000_000)
        assert np.linalg.norm(now.r_e - world.r_e[k]) < 0.05
        assert np.linalg.norm(now.omega_eb_b - world.omega[k - 1]) < 1e-3


def with_fix_off(world, size):
    """A good fix that lies so far [m] to the side."""
    [fix, *_] = world.fixes(100.0, 0.5, sigma=0.01, first_s=3.0)
    side_e = grid.ecef_to_grid(fix.r_e).T @ np.array([0.6, 0.8, 0.0])
    return replace(fix, r_e=fix.r_e + size * side_e)


@pytest.mark.parametrize('size', [0.3, 3.0])
def test_a_fix_that_moves_the_estimate_adds_little_acceleration(world, size):
    events = as_they_come([*world.imu(), *world.dvl(), *world.depth()])
    still = Rig(world, initial_sigma_position=10.0)
    moved = Rig(world, initial_sigma_position=10.0)
    a, b = still.feed(events), moved.feed(as_they_come([*events, with_fix_off(world, size)]))
    off = np.array([y.r_e - x.r_e for x, y in zip(a, b, strict=True)])
    raw = moved.predictor._track.r_e - still.predictor._track.r_e
    assert np.linalg.norm(raw) > 0.8 * size
    assert b[-1].jumps == 0
    assert np.linalg.norm(np.diff(off, axis=0), axis=1).max() < 0.02 * size
    # Differences over 0.1 s: the motion of the vehicle is in both, and rounding is small.
    added = np.linalg.norm(off[20:] - 2 * off[10:-10] + off[:-20], axis=1) / 0.1**2
    assert 0.02 < added.max() < 0.105
    assert np.linalg.norm(off[-1] - raw) < 0.02 * size


def test_beyond_the_limit_it_jumps_and_counts(world):
    rig = Rig(world, initial_sigma_position=30.0)
    found = rig.feed(as_they_come([*world.imu(), with_fix_off(world, 9.0)]))
    steps = np.linalg.norm(np.diff([now.r_e for now in found], axis=0), axis=1)
    assert found[-1].jumps == 1
    assert np.count_nonzero(steps > 1.0) == 1
    # What is moved without corrections has no step.
    assert max(np.linalg.norm(now.moved_e) for now in found) < 0.04


def test_a_new_state_counts_as_a_jump(world):
    rig = Rig(world)
    samples = world.imu()
    rig.feed(samples[:300])
    initial = rig.params.initial_state()
    assert isinstance(initial, InitialState)
    stamp_ns = samples[299].stamp_ns
    rig.feed([Command(stamp_ns, 0, CommandKind.RESET, initial), *samples[300:]])
    assert rig.found[-1].jumps == 1
    assert rig.found[-1].stamp_ns == samples[-1].stamp_ns


def test_the_covariance_is_finite_and_grows_with_the_time_ahead(world):
    events = as_they_come([*world.imu(), *world.dvl(), *world.depth()])
    rigs = [Rig(world, window_s) for window_s in (0.05, 2.0)]
    variances = []
    for rig in rigs:
        rig.feed(events)
        P = rig.predictor.covariance(rig.reorder.engine)
        assert np.isfinite(P).all()
        assert np.linalg.eigvalsh(P[:9, :9]).min() > 0.0
        own = rig.reorder.engine.fusion.filter.published_P
        variances.append(np.trace(P[6:9, 6:9]) / np.trace(own[6:9, 6:9]))
    assert 1.0 <= variances[0] < variances[1]


def test_samples_beyond_the_sensor_are_left_out(world):
    samples = world.imu()
    bad = ImuSample(samples[500].stamp_ns, 500, np.full(3, np.nan), np.full(3, 1e4))
    found = Rig(world).feed([*samples[:500], bad, *samples[501:]])
    assert np.isfinite([now.r_e for now in found]).all()
    assert found[-1].stamp_ns == samples[-1].stamp_ns
    assert np.linalg.norm(found[-1].r_e - world.r_e[-1]) < 0.1


def test_the_covariance_is_that_of_the_state_carried_on(world):
    rig = Rig(world, 2.0, initial_sigma_position=10.0)
    rig.feed(as_they_come([*world.imu(), *world.dvl(), with_fix_off(world, 3.0)]))
    fusion, predictor = rig.reorder.engine.fusion, rig.predictor
    f, track = fusion.filter, predictor._track
    dt = (rig.found[-1].stamp_ns - f.stamp_ns) * 1e-9
    force_b = track.increments[1] / track.previous_dt[0]
    F = np.eye(15)
    F[X.phi_G, X.b_gyro_b] = -track.C_b_G * dt
    F[X.dv_G, X.phi_G] = attitude.skew(track.C_b_G @ force_b) * dt
    F[X.dv_G, X.b_accel_b] = track.C_b_G * dt
    F[X.dr_e, X.dv_G] = track.C_e_G.T * dt
    P = F @ f.published_P[:15, :15] @ F.T
    noise = f.settings.densities[:2] * dt * (1.0 + float(f.state.excess[0]))
    P[np.arange(6), np.arange(6)] += np.repeat(noise, 3)
    b, rate = predictor._offset_e.at(rig.found[-1].stamp_ns)
    c, _ = predictor._turn_e.at(rig.found[-1].stamp_ns)
    for part, u in (
        (X.dr_e, b),
        (X.dv_G, track.C_e_G @ rate),
        (X.phi_G, track.C_e_G @ c),
    ):
        assert np.any(u)
        P[part, part] += np.outer(u, u)
    found = predictor.covariance(rig.reorder.engine)
    scale = np.sqrt(np.outer(np.diagonal(P), np.diagonal(P)))
    assert np.abs((found - P) / scale).max() < 1e-9


@pytest.mark.parametrize('window_s', [0.0, 0.3])
@pytest.mark.parametrize(('imu_hz', 'lost'), [(100, range(20, 25)), (10, range(2, 4))])
def test_missing_samples_move_it_by_little(world, window_s, imu_hz, lost):
    """The filter interpolates them later; a ping among them, for which it does not wait."""
    every = 100 // imu_hz
    samples = world.imu()
    if every > 1:
        samples = [_mean(samples[k : k + every]) for k in range(0, len(samples) - every, every)]
    kept = [s for k, s in enumerate(samples) if k % (imu_hz // 2) not in lost]
    rig = Rig(world, window_s)
    found = rig.feed(as_they_come([*kept, *world.dvl(every=7), *world.depth()]))
    both = [(now, rig.later[now.stamp_ns]) for now in found if now.stamp_ns in rig.later]
    assert len(both) > 20
    for now, (r_e, _, _) in both:
        assert np.linalg.norm(now.r_e - r_e) < 0.05  # as to the truth, above
    assert found[-1].stamp_ns == kept[-1].stamp_ns
    assert found[-1].jumps == 0


def _mean(samples):
    omega_ib_b = np.mean([s.omega_ib_b for s in samples], axis=0)
    return replace(samples[-1], omega_ib_b=omega_ib_b, f_b=np.mean([s.f_b for s in samples], 0))
