"""Left-out points change no pixel."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_tools.report.decimate import distinct, envelope, simplified


@settings(deadline=None, max_examples=60)
@given(
    n=st.integers(1, 3000),
    columns=st.integers(1, 80),
    seed=st.integers(0, 10**6),
    holes=st.sampled_from([0.0, 0.1, 1.0]),
)
def test_every_column_keeps_its_extent(n, columns, seed, holes):
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(0.0, 1.0, n))
    y = np.cumsum(rng.normal(size=n))
    y[rng.random(n) < holes] = np.nan
    keep = envelope(x, y, columns)
    assert (np.diff(keep) > 0).all()
    assert keep[0] == 0
    assert keep[-1] == n - 1
    span = x[-1] - x[0]
    column = np.minimum((x - x[0]) * (columns / span) if span > 0 else 0 * x, columns - 1)
    column = column.astype(int)
    for k in np.unique(column):
        all_y, kept_y = y[column == k], y[keep][column[keep] == k]
        if np.isfinite(all_y).any():
            assert np.nanmin(kept_y) == np.nanmin(all_y)
            assert np.nanmax(kept_y) == np.nanmax(all_y)
        # A break of the line stays one.
        assert np.isnan(all_y).any() == np.isnan(kept_y).any()


def test_a_long_series_becomes_short():
    x = np.linspace(0.0, 1.0, 432_001)
    keep = envelope(x, np.sin(1e4 * x), 480)
    assert len(keep) <= 4 * 480 + 1


@settings(deadline=None, max_examples=40)
@given(n=st.integers(2, 400), seed=st.integers(0, 10**6), tolerance=st.floats(0.01, 3.0))
def test_a_simplified_path_stays_within_tolerance(n, seed, tolerance):
    p = np.cumsum(np.random.default_rng(seed).normal(size=(n, 2)), axis=0)
    keep = simplified(p, tolerance)
    assert keep[0] == 0
    assert keep[-1] == n - 1
    for a, b in pairwise(keep):
        d = p[b] - p[a]
        for k in range(a + 1, b):
            t = np.clip((p[k] - p[a]) @ d / (d @ d), 0.0, 1.0) if d.any() else 0.0
            assert np.hypot(*(p[k] - p[a] - t * d)) <= tolerance * (1 + 1e-9)


def test_a_straight_track_is_two_points():
    p = np.stack([np.linspace(0, 1800, 60001), np.linspace(0, 900, 60001)], axis=1)
    assert len(simplified(p, 0.5)) == 2


def test_markers_one_per_cell():
    rng = np.random.default_rng(0)
    x, y = rng.random(50_000), rng.random(50_000)
    keep = distinct(x, y, 20, 10)
    assert len(keep) == 200
    assert len(distinct(x, np.zeros(50_000), 20, 10)) == 20
    assert len(distinct(x[:0], y[:0], 20, 10)) == 0


@pytest.mark.parametrize(
    ('call', 'words'),
    [
        (lambda: envelope(np.arange(9.0), np.arange(9.0), 0), 'columns=0'),
        (lambda: simplified(np.zeros((5, 2)), 0.0), r'tolerance=0\.0'),
    ],
)
def test_bad_arguments(call, words):
    with pytest.raises(ValueError, match=words):
        call()
