"""The picture of the covariance's honesty: its parts by hand, and what it says in words."""

import dataclasses
import re

import numpy as np
import pytest
from scipy.stats import chi2

from polar_nav_tools.report.example import example_input
from polar_nav_tools.report.figures import Clock, honesty
from polar_nav_tools.report.figures.honesty import binned


def test_parts_of_a_run_by_hand():
    t = np.array([0.5, 0.6, 1.5, 39.5])
    bins = binned(t, np.array([2.0, 7.0, 30.0, 1.0]), np.array([3.0, 6.0, 3.0, 0.0]), (0.0, 40.0))
    assert bins.mean[0] == pytest.approx(9.0 / 9.0)
    assert bins.mean[1] == pytest.approx(10.0)
    assert np.isnan(bins.mean[2:]).all()  # nothing there, or of no degree of freedom
    assert [bins.low[0], bins.high[0]] == pytest.approx(list(chi2.ppf([0.025, 0.975], 9) / 9))
    assert bins.share_inside == 0.5


def test_nothing_at_all_has_no_share():
    none = np.empty(0)
    assert np.isnan(binned(none, none, none, (0.0, 1.0)).share_inside)


def shares(estimate_of):
    data = example_input(minutes=6.0)
    truth, estimate, receipts = data.runs['modified_akf']
    clock = Clock(int(truth.stamp_ns[0]), int(truth.stamp_ns[-1]))
    score = data.scored().scores['modified_akf']
    alt = honesty(score, 0, estimate_of(estimate), receipts, clock).alt
    return {k: float(v) for k, v in re.findall(r'NIS of (\w+) (\d+) %', alt)}


@pytest.mark.slow
def test_the_picture_tells_an_honest_filter_from_one_that_is_not():
    honest = shares(lambda e: e)
    assert set(honest) == {'fixes', 'DVL', 'depth'}

    def too_sure(e):
        louder = e.local_statistics.copy()
        louder[:, 0, 2] *= 4.0  # DVL noise stated at half of what it is
        return dataclasses.replace(e, local_statistics=louder)

    found = shares(too_sure)
    assert honest['DVL'] > 70.0
    assert found['DVL'] == 0.0
    assert found['depth'] == honest['depth']
