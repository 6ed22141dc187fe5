"""An offset is bled off with bounded acceleration, whatever comes while it is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_core.engine.bleed import Bleed

LIMIT, SHORTEST_S, LARGEST = 0.1, 2.0, 5.0
SECOND_NS = 1_000_000_000
vector = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


def one(offset, rate=(0.0, 0.0, 0.0)):
    bleed = Bleed(LIMIT, SHORTEST_S, LARGEST)
    taken = bleed.add(0, np.array(offset, dtype=float), np.array(rate, dtype=float))
    return bleed, taken


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 400), vector, vector), min_size=1, max_size=12))
def test_the_acceleration_is_bounded_and_the_track_has_no_step(steps):
    """`steps`: after so many hundredths of a second an offset and a rate are added."""
    bleed = Bleed(LIMIT, SHORTEST_S, LARGEST)
    now_ns = 0
    for ticks, offset, rate in steps:
        before = bleed.at(now_ns)
        added = (2.0 * offset, 0.1 * rate)
        if not bleed.add(now_ns, *added):
            assert np.linalg.norm(before[0] + added[0]) > LARGEST
            bleed.clear()
        else:
            for part, (was, more) in zip(
                bleed.at(now_ns), zip(before, added, strict=True), strict=True
            ):
                np.testing.assert_allclose(part, was + more, atol=1e-12)
        rates, offsets = [], []
        for k in range(ticks + 1):
            offset_k, rate_k = bleed.at(now_ns + k * 10_000_000)
            rates.append(rate_k)
            offsets.append(offset_k)
        acceleration = np.linalg.norm(np.diff(rates, axis=0), axis=1) / 0.01
        assert acceleration.max(initial=0.0) <= LIMIT * (1.0 + 1e-9)
        # The rate is that of the offset: exact for a constant acceleration, one switch apart.
        middle = 0.5 * (np.array(rates[1:]) + np.array(rates[:-1])) * 0.01
        np.testing.assert_allclose(np.diff(offsets, axis=0), middle, atol=0.1 * 0.01**2)
        now_ns += ticks * 10_000_000


@pytest.mark.parametrize(('size', 'gone_s'), [(0.05, 2.1), (0.5, 5.1), (2.0, 10.2), (5.0, 16.2)])
def test_how_long_a_step_lasts(size, gone_s):
    bleed, taken = one([0.6 * size, 0.8 * size, 0.0])
    assert taken
    assert np.any(bleed.at(round(0.9 * gone_s * SECOND_NS))[0])
    offset, rate = bleed.at(round(gone_s * SECOND_NS))
    assert not offset.any()
    assert not rate.any()


def test_the_end_is_reached_smoothly():
    bleed, _ = one([1.0, -2.0, 0.5], [0.05, 0.0, -0.1])
    end_ns = round(bleed.profile.duration_s[0] * 1e9)
    offset, rate = bleed.at(end_ns - 1)
    assert np.abs(offset).max() < 1e-9
    assert np.abs(rate).max() < 1e-9


@pytest.mark.parametrize('offset', [[5.1, 0.0, 0.0], [np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0]])
def test_what_is_too_large_is_refused(offset):
    bleed, taken = one(offset)
    assert not taken
    assert not bleed.active


def test_a_velocity_that_no_profile_ends_in_time_is_refused():
    assert not one([0.0, 0.0, 0.0], [20.0, 0.0, 0.0])[1]
