"""Constants that a recording contradicts: score tests, their sigmas, what is not said."""

import math
from dataclasses import replace

import numpy as np
import pytest

from polar_nav_core.engine import smoothing
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.kernels.sins import consider
from polar_nav_tools.calibration.constants import CONSTANTS
from polar_nav_tools.calibration.suspects import (
    BLOCKS,
    SURE,
    Evidence,
    Known,
    constants_of,
    off,
    suspects,
)
from polar_nav_tools.experiments.calibrate.rows import params_of, world_of
from polar_nav_tools.experiments.mismatch.dvl_faults import DvlPlace
from polar_nav_tools.experiments.mismatch.faults import FixClock
from polar_nav_tools.series.estimates import EstimateRows
from polar_nav_tools.smoothing.doubts import Doubt, Doubts, doubts_of

DURATION_S = 300.0
STAMPS = np.arange(600) * 10**9


def problem(columns=3, seed=1):
    """Rows of so many columns, white innovations, and what is known of the columns."""
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(len(STAMPS), 3, columns))
    known = Known(np.zeros(columns), np.full(columns, 1e-9), np.full(columns, 10.0))
    return M, rng.normal(size=(len(STAMPS), 3)), known


def found_in(M, white, known, places=(0, 1, 2)):
    return off(Evidence.of(M, white, STAMPS), known, places)


def test_a_column_that_is_off_is_the_least_squares_estimate_and_the_only_one():
    M, white, known = problem()
    white = white + M @ np.array([0.0, 0.4, 0.0])
    (one,) = found_in(M, white, known)
    row = M[:, :, 1].ravel()
    assert one.column == 1
    assert one.value == pytest.approx(row @ white.ravel() / (row @ row), rel=1e-3)
    assert one.sigma >= 0.99 / math.sqrt(row @ row)
    assert one.sigmas == pytest.approx(one.value / one.sigma, rel=1e-6)


def test_white_innovations_say_nothing():
    for seed in range(20):
        M, white, known = problem(seed=seed)
        assert found_in(M, white, known) == ()


def test_innovations_that_stay_alike_for_a_while_say_less():
    """A random walk in step with a column is many sigmas of white noise, and none of its own."""
    said = 0
    for seed in range(20):
        M, white, known = problem(columns=1, seed=seed)
        M[:] = 1.0
        slow = np.repeat(np.random.default_rng(seed).normal(size=BLOCKS), len(STAMPS) // BLOCKS)
        white = white + slow[:, None]
        row = M[:, :, 0].ravel()
        plain = abs(row @ white.ravel()) / math.sqrt(row @ row)
        said += plain > SURE
        assert found_in(M, white, known, (0,)) == ()
    assert said > 5


def test_what_is_stated_of_a_column_is_no_news():
    M, white, known = problem()
    white = white + M @ np.array([0.0, 0.4, 0.0])
    assert found_in(M, white, replace(known, least=np.array([0.0, 0.1, 0.0]))) == ()
    assert found_in(M, white, replace(known, least=np.array([0.0, 0.05, 0.0])))


def test_a_nuisance_that_explains_it_leaves_nothing():
    M, white, known = problem()
    M[:, :, 2] = M[:, :, 1]
    white = white + M @ np.array([0.0, 0.4, 0.0])
    known = replace(known, stated=np.array([0.0, 0.0, 10.0]))
    assert found_in(M, white, known, (0, 1)) == ()


def test_columns_that_are_alike_are_one_and_name_each_other():
    M, white, known = problem()
    M[:, :, 2] = -3.0 * M[:, :, 1]
    white = white + M @ np.array([0.0, 0.4, 0.0])
    (one,) = found_in(M, white, known)
    assert (one.column, one.alike) == (1, (2,))
    (other,) = found_in(M, white, known, (2, 1))
    assert (other.column, other.alike) == (2, (1,))
    assert other.value == pytest.approx(-one.value / 3.0, rel=0.01)


def test_two_that_are_off_are_both_found_beside_one_another():
    M, white, known = problem()
    M[:, :, 1] += 0.5 * M[:, :, 0]
    white = white + M @ np.array([0.3, -0.5, 0.0])
    found = {one.column: one.value for one in found_in(M, white, known)}
    assert set(found) == {0, 1}
    assert found[0] == pytest.approx(0.3, abs=0.1)
    assert found[1] == pytest.approx(-0.5, abs=0.1)


def test_less_than_the_default_of_the_engine_is_no_news_whatever_is_stated():
    params = EngineParams(dvl_lever_sigma=0.0, fix_clock_sigma=3.0)
    world = world_of('lawnmower', 60.0, 5)
    constants = constants_of(params, world.inputs)
    known = Known.of(params, constants, consider.COLUMNS + 2)
    assert known.stated[consider.DVL_LEVER_X] == 0.0
    assert known.least[consider.DVL_LEVER_X] == EngineParams().dvl_lever_sigma
    assert known.least[consider.CLOCK] == known.stated[consider.CLOCK] == 3.0
    assert (known.least[consider.COLUMNS :] == EngineParams().dvl_lever_sigma).all()


def doubted(world, **changes):
    """What speaks against the smoothed track of a world."""
    params = replace(params_of(world), output_period_s=1.0, **changes)

    def series(params, inputs):
        track = smoothing.smooth(params, inputs, passes=1).track
        rows = EstimateRows(params, len(track.stamps_ns))
        rows.append(track)
        return rows.series('follower')

    return doubts_of(params, world.inputs, series(params, world.inputs), series)


@pytest.mark.slow
@pytest.mark.parametrize('scene', ['lawnmower', 'circle'])
def test_late_fixes_are_said_with_their_size_and_command(scene):
    world = FixClock(offset_s=1.5).applied(world_of(scene, DURATION_S, 7), 1.0)
    found = doubted(world)
    (one,) = found.found
    assert one.constant.name == 'delay'
    assert abs(one.value - 1.5) < 4.0 * one.sigma < 0.4
    assert found.moved_sigma > 3.0
    assert 'delay' in found.complaint
    (said,) = found.sentences('cruise.mcap')
    assert 'm behind along the track, as if 1.' in said
    assert 's late' in said
    assert said.endswith('./polar calibrate cruise.mcap --only delay')
    assert found.to_dict('cruise.mcap')['found'][0]['sentence'] == said


@pytest.mark.slow
def test_a_lever_arm_is_said_and_what_is_right_is_not():
    world = world_of('lawnmower', DURATION_S, 8)
    assert doubted(world) == Doubts()
    wrong = DvlPlace(lever_b=(1.0, 0.0, 0.0)).applied(world, 1.0)
    (one,) = doubted(wrong).found
    assert one.constant.name == 'dvl_lever_x'
    assert one.value == pytest.approx(1.0, abs=0.05)
    # What the parameters state of it, nobody needs to be told.
    assert suspects(replace(params_of(wrong), dvl_lever_sigma=0.3), wrong.inputs) == ()


@pytest.mark.parametrize(('moved', 'said'), [(0.9, ''), (1.1, '1.1 of its'), (math.nan, 'wrong')])
def test_what_moves_the_track_by_less_than_its_sigma_is_no_complaint(moved, said):
    (delay,) = (c for c in CONSTANTS if c.name == 'delay')
    found = Doubts((Doubt(delay, 0.6, 0.1, 6.0, ()),), 0.2, moved, speed=2.0)
    assert said in found.complaint
    assert bool(found.complaint) == bool(said)
    assert found.sentences('bag')[0].startswith('fixes lie 1.2 ± 0.2 m behind along the track')
