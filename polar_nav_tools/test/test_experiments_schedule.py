"""Schedules of fixes: statistics of delays and losses, order of arrival."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chisquare

from polar_nav_core.errors import ConfigError
from polar_nav_sim.randomness import stream
from polar_nav_tools.experiments.schedule import (
    FixSpec,
    clairvoyant,
    delays_ns,
    fixes_of,
    validity_times,
)

COUNT = 20_000


def delays(**spec):
    return delays_ns(FixSpec(**spec), COUNT, stream(1, 'delay'))


def test_a_constant_delay_is_constant():
    assert set(delays(delay_s=2.5)) == {2_500_000_000}


@pytest.mark.parametrize('steps', [1, 5, 20])
def test_random_steps_are_uniform_from_one_to_d(steps):
    found = delays(delay_kind='steps', delay_steps=steps)
    values, counts = np.unique(found, return_counts=True)
    np.testing.assert_array_equal(values, 100_000_000 * np.arange(1, steps + 1))
    assert steps == 1 or chisquare(counts).pvalue > 1e-3
    spec = FixSpec(delay_kind='steps', delay_steps=steps)
    assert found.mean() * 1e-9 == pytest.approx(spec.mean_delay_s, rel=0.02)
    assert found.max() * 1e-9 == pytest.approx(spec.longest_delay_s)


def test_uniform_delays_lie_between_their_limits():
    found = delays(delay_kind='uniform', delay_least_s=1.0, delay_s=10.0) * 1e-9
    assert 1.0 <= found.min() < 1.01
    assert 9.99 < found.max() <= 10.0
    assert found.mean() == pytest.approx(5.5, rel=0.01)


def test_reading_back_drops_what_the_equations_never_read():
    found = delays(delay_kind='steps_lossy', delay_steps=100)
    read = found[found > 0]
    # A fix is missed by 100 readers with probability (1 - 1/100)^100.
    assert 1.0 - len(read) / COUNT == pytest.approx(0.99**100, abs=0.01)
    assert read.max() <= 100 * 100_000_000
    # Of several readings the earliest counts: shorter than the mean of the draws.
    assert read.mean() * 1e-9 < 0.5 * 101 * 0.1
    with pytest.raises(ConfigError, match='period_s: 1'):
        delays(delay_kind='steps_lossy', period_s=1.0)


def test_losses_have_the_stated_share():
    assert np.mean(delays(delay_s=1.0, loss=0.3) < 0) == pytest.approx(0.3, abs=0.01)


def test_times_of_validity():
    times = validity_times(FixSpec(period_s=2.0, first_s=1.0), 10**12, 10**12 + 7 * 10**9)
    np.testing.assert_array_equal(times - 10**12, [1e9, 3e9, 5e9, 7e9])


def test_fixes_come_in_order_of_arrival_and_keep_their_numbers():
    validity = np.array([1, 2, 3], dtype=np.int64)
    receive = np.array([9, 4, 6], dtype=np.int64)
    r_e, covariance_e = np.arange(9.0).reshape(3, 3), np.tile(np.eye(3), (3, 1, 1))
    fixes = fixes_of(validity, receive, r_e, covariance_e)
    assert [f.sequence for f in fixes] == [1, 2, 0]
    assert [f.arrival for f in fixes] == [0, 1, 2]
    prompt = clairvoyant(fixes)
    assert [(f.sequence, f.receive_ns) for f in prompt] == [(0, 1), (1, 2), (2, 3)]
    np.testing.assert_array_equal(prompt[0].r_e, r_e[0])


def test_limits_are_checked_by_name():
    with pytest.raises(ConfigError, match='delay_s: 121'):
        FixSpec(delay_s=121.0)
    with pytest.raises(ConfigError, match='delay_kind'):
        dataclasses.replace(FixSpec(), delay_kind='never')
