"""Looks of the watchdog at compiled runs: no bit changes, and they see what single steps see."""

import numpy as np
import pytest
from closed_loop import World, inputs_of

from polar_nav_core import earth, grid
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.inputs import new_seconds
from polar_nav_core.engine.looks import looks_of
from polar_nav_core.engine.sins.view import view_of
from polar_nav_core.error_model import X


@pytest.fixture(scope='module')
def world():
    return World(60.0)


@pytest.fixture(scope='module')
def inputs(world):
    return inputs_of(world, world.fixes(1.0, lambda _: 0.5, first_s=1.0))


def test_looks_come_with_the_first_sample_of_every_so_many_seconds(inputs):
    seconds = new_seconds(inputs.imu_stamps_ns)
    stamps = [look.stamp_ns for look in looks_of(seconds, 10.0)]
    assert [s // 10**9 % 10 for s in stamps] == [0] * len(stamps)
    assert len(stamps) in (5, 6)
    assert set(stamps) <= {int(s) for s in inputs.imu_stamps_ns}
    assert [look.stamp_ns for look in looks_of(seconds, 1.0)] == seconds
    assert looks_of(seconds, 0.0) == []


@pytest.mark.parametrize('wrong_deg', [0.0, 5.0])
def test_a_compiled_run_is_looked_at_without_a_change_of_bits(world, inputs, wrong_deg):
    """With a heading that is wrong and sure: the DVL is refused, then used again."""
    heading = world.params().initial_grid_heading_deg
    params = world.params(
        configuration='default',
        initial_grid_heading_deg=heading + wrong_deg,
        initial_sigma_heading_deg=5.0 / 60.0,
    )
    single = engine_run.run(params, inputs, one_by_one=True)
    plain = engine_run.run(params, inputs)
    looked = engine_run.run(params, inputs, look_every_s=1.0)
    assert plain.health == ()
    np.testing.assert_array_equal(looked.track.P, plain.track.P)
    np.testing.assert_array_equal(looked.track.r_e, plain.track.r_e)
    np.testing.assert_array_equal(looked.track.r_e, single.track.r_e)
    assert [str(r) for r in looked.receipts] == [str(r) for r in plain.receipts]
    count = len(single.health)
    assert count > 50
    levels = [h.level for h in looked.health[:count]]
    assert levels == [h.level for h in single.health]
    assert (max(levels) == 2) is (wrong_deg > 0.0)
    assert [h.resets for h in looked.health[:count]] == [h.resets for h in single.health]


def test_a_look_sees_what_is_published(world, inputs):
    """With common errors of fixes and depth, and refused fixes that the state may belong to."""
    common = {'fix_offset_sigma': 2.0, 'depth_offset_sigma': 0.2}
    engine = Engine(world.params(configuration='default', **common))
    for number, event in enumerate(inputs.events()):
        list(engine.process(event))
        if number % 1000 != 999:
            continue
        f, stamp_ns = engine.fusion.filter, engine.fusion.stamp_ns
        f.state.conflict[:] = np.arange(1.0, 7.0) * 0.3
        view, P = view_of(engine.fusion, stamp_ns, 0), f.published_P
        f.state.conflict[:] = 0.0
        r_e = f.state.r_e
        C_e_G = np.asarray(grid.ecef_to_grid(r_e))
        expected = (C_e_G @ P[X.dr_e, X.dr_e] @ C_e_G.T)[:2, :2]
        np.testing.assert_allclose(view.P_horizontal, expected, rtol=1e-12)
        assert view.depth == pytest.approx(-earth.geodetic_from_ecef(r_e)[2], abs=1e-8)
        assert view.speed == pytest.approx(np.linalg.norm(f.state.v_G), rel=1e-12)
    assert P[X.dr_e, X.dr_e].trace() > f.state.P[X.dr_e, X.dr_e].trace() + 4.0
