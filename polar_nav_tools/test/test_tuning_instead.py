"""What else than noise explains a recording: axes, a delay; what is then suggested: nothing."""

import math
from dataclasses import replace

import numpy as np
import pytest

from polar_nav_core.attitude import exp
from polar_nav_tools.experiments.tune.rows import ROWS
from polar_nav_tools.tuning.instead import (
    DECISIVE,
    gain_of,
    instead_of_noise,
    turns,
)
from polar_nav_tools.tuning.likelihood import Problem, Rows
from polar_nav_tools.tuning.parameters import parameters_of
from polar_nav_tools.tuning.solve import Fit
from polar_nav_tools.tuning.verdicts import less_honest

DURATION_S = 100.0


def dvl_lever(params, inputs):
    """A DVL two metres further forward than its parameters say."""
    return replace(params, dvl_lever_b=(-2.0, 0.0, 0.0)), inputs


def rows(white, ranks):
    """Rows of one number each."""
    n, w = len(white), np.zeros((len(white), 3))
    w[:, 0] = white
    ones = np.ones(n, dtype=np.int64)
    return Rows(np.arange(n), np.asarray(ranks), ones, w, np.zeros((n, 3)), ones)


def test_a_gain_is_that_of_all_measurements():
    white, ranks = np.linspace(-2.0, 2.0, 40), [1, 2] * 20
    one, other = rows(0.5 * white, ranks), rows(white, ranks)
    whole = one.ln_density().sum() - other.ln_density().sum()
    assert gain_of(one, other) == pytest.approx(whole)
    assert gain_of(other, other) == 0.0


def test_measurements_that_have_gone_over_an_end_count_for_nothing():
    other = rows(np.ones(40), [1, 2] * 20)
    one = rows(np.ones(39), ([1, 2] * 20)[1:])
    assert gain_of(one, other) == pytest.approx(0.0)
    assert gain_of(rows(np.ones(20), [1] * 20), other) == -math.inf
    assert gain_of(None, other) == -math.inf


def test_turns_are_all_axes_with_a_name_and_some_between():
    found = turns()
    assert len(found) == 23 + 8 + 3
    assert sum(np.linalg.det(C) < 0.0 for C in found) == 3
    for C in found:
        np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ('stated', 'suggested', 'worse'),
    [
        (13.0, 306.0, True),
        (0.1, 1.3, False),
        (30.0, 4.0, False),
        (1.0, 1.9, False),
        (1.0, 0.2, False),
    ],
)
def test_a_nees_that_gets_worse_is_said(stated, suggested, worse):
    def of(mean):
        return {'position': _Mean(mean)}

    said = less_honest({'stated': of(stated), 'suggested': of(suggested)})
    assert bool(said) == worse
    assert less_honest({}) == []


class _Mean:
    """As much of a `Consistency` as is looked at."""

    band_low, band_high = 0.5, 1.6

    def __init__(self, mean_per_dof):
        self.mean_per_dof = mean_per_dof


def instead_of(change, factor, seed=11):
    """What explains a recording in place of a white noise of the DVL that is so much larger."""
    (right,) = (row for row in ROWS if row.name == 'right')
    params, inputs, _ = right.stated(DURATION_S, seed)
    params, inputs = change(params, inputs)
    noises = [p for p in parameters_of(params, inputs) if p.name == 'dvl_sigma']
    first_ns, last_ns = inputs.imu_stamps_ns[[0, -1]].tolist()
    train = Problem(params, inputs, noises, first_ns + 5 * 10**9, last_ns)
    at, nothing = np.array([math.log(factor)]), np.zeros(1)
    rows = train.rows(at)
    found = Fit(
        at, nothing, nothing + math.log(3.0), np.eye(1), float(rows.ln_density().sum()), rows, True
    )
    return instead_of_noise(train, found, at)


def a_turned_dvl(params, inputs):
    C = exp(np.array([0.0, 0.0, math.radians(90.0)]))
    return params, replace(inputs, dvl_v_m=np.ascontiguousarray(inputs.dvl_v_m @ C.T))


def ten_times_too_sure(params, inputs):
    return params, replace(inputs, dvl_covariance_m=0.01 * inputs.dvl_covariance_m)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('change', 'words'),
    [(a_turned_dvl, 'by roll, pitch, yaw 0, 0, -90 deg'), (dvl_lever, 'DVL further forward +')],
)
def test_an_error_that_lasts_is_not_taken_for_noise(change, words):
    instead = instead_of(change, 30.0)
    assert instead is not None
    assert words in instead.alternative.words
    assert instead.gain > DECISIVE
    ((_, without, beside),) = instead.smaller
    assert beside == pytest.approx(without / 30.0, rel=0.2)
    assert 'something else than noise is wrong' in instead.sentence
    assert instead.to_dict()['as_if'] == instead.alternative.words


@pytest.mark.slow
def test_noise_is_taken_for_noise():
    assert instead_of(ten_times_too_sure, 10.0) is None
