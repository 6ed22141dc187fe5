"""Machine code that is called without a look at the types of its arguments."""

import numpy as np
import pytest

from polar_nav_core.kernels import watch
from polar_nav_core.kernels.statistics import WIDTH, fill_statistics, largest_share
from polar_nav_core.machine_code import Direct


def test_other_types_are_met_with_other_code():
    """Rows that are no longer side by side, as those of a live and of a whole run differ."""
    rng = np.random.default_rng(3)
    direct = Direct(fill_statistics)
    dense = rng.uniform(1.0, 2.0, (4, watch.WIDTH))
    wide = np.zeros((4, 2 * watch.WIDTH))
    wide[:, ::2] = dense
    expected = np.empty((4, WIDTH))
    fill_statistics(dense, expected)
    for memories in (dense, wide[:, ::2], dense, dense):
        out = np.full((4, WIDTH), np.nan)
        direct.call((memories,), memories, out)
        np.testing.assert_array_equal(out, expected)


def test_objects_that_stand_for_types_are_as_many_in_every_call():
    direct, memories = Direct(fill_statistics), np.ones((1, watch.WIDTH))
    direct.call((memories,), memories, np.empty((1, WIDTH)))
    with pytest.raises(ValueError, match='argument'):
        direct.call((), memories, np.empty((1, WIDTH)))


def by_hand(numbers, squares, sums, fewest, most, highest):
    """Largest share, by all of them in a list."""
    shares = []
    for memory, number in enumerate(numbers):
        for axis in range(3):
            share = sums[memory, axis] / highest
            if number >= fewest:
                share = max(share, squares[memory, axis] / most[memory])
            shares.append((share, -len(shares), memory, axis))
    share, _, memory, axis = max(shares)
    return share, memory, axis


def test_largest_share_is_that_of_a_list():
    rng = np.random.default_rng(4)
    for _ in range(200):
        numbers = rng.uniform(0.0, 20.0, 2)
        squares, sums = rng.exponential(30.0, (2, 2, 3)).round(rng.integers(-1, 3))
        given = numbers, squares, sums, 10.0, np.array([45.0, 40.0]), 17.3
        assert largest_share(*given) == by_hand(*given)
