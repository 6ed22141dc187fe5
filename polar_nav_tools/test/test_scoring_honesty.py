"""The headline of a score is the worst judgement of position, velocity and heading."""

import numpy as np
import pytest

from polar_nav_tools.report.example import estimate_with_errors, example_truth
from polar_nav_tools.scoring import compare
from polar_nav_tools.scoring.honesty import honesty_of, worst_of
from polar_nav_tools.scoring.score import score

TRUTH = example_truth('f', 80.0, 120.0, 5.0)
COUNT = len(TRUTH.stamp_ns)


def white(seed, scale):
    return scale * np.random.default_rng(seed).standard_normal((COUNT, 3))


def made(*, r=1.0, v=1.0, phi=1.0, heading=1.0, only_first_half=False):
    """Estimates with white errors, so many times the stated 1 m, 0.01 m/s, 1 mrad."""
    half = np.where(np.arange(COUNT) < 0.4 * COUNT, 1.0, 0.0)[:, None] if only_first_half else 1.0
    grow = {k: 1.0 + (x - 1.0) * half for k, x in (('r', r), ('v', v), ('phi', phi))}
    errors = {'r': white(1, 1.0), 'v': white(2, 0.01), 'phi': white(3, 1e-3)}
    one = np.ones((COUNT, 3))
    return estimate_with_errors(
        TRUTH,
        'one',
        dr_G=errors['r'] * grow['r'],
        dv_G=errors['v'] * grow['v'],
        phi_G=errors['phi'] * grow['phi'] * np.array([1.0, 1.0, heading]),
        sigma_r=one,
        sigma_v=0.01 * one,
        sigma_phi=1e-3 * one,
    )


def run(**wrong):
    return score('one', TRUTH, made(**wrong), ())


def test_an_honest_run_is_called_honest():
    one = run()
    assert {h.word for h in honesty_of(one)} <= {'honest', 'optimistic', 'pessimistic'}
    for h in honesty_of(one):
        assert h.found.mean_per_dof == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize(
    ('wrong', 'quantity'),
    [({'heading': 3.5}, 'heading'), ({'v': 2.0}, 'velocity'), ({'r': 2.0}, 'position')],
)
def test_one_wrong_quantity_is_the_headline(wrong, quantity):
    """As a heading with NEES 12 beside a position with 0.66 was not."""
    one = run(**wrong)
    worst = worst_of(one)
    assert (worst.quantity, worst.word) == (quantity, 'optimistic')
    size = next(iter(wrong.values()))
    assert worst.found.mean_per_dof == pytest.approx(size**2, rel=0.15)
    row = compare({'a': (TRUTH, made(**wrong), ())}).table().records()[0]
    assert row['honesty'] == 'optimistic'
    assert row['worst_quantity'].startswith(quantity)
    assert row['worst_per_dof'] == worst.found.mean_per_dof


def test_the_first_half_counts():
    worst = worst_of(run(r=4.0, only_first_half=True))
    assert (worst.quantity, worst.window, worst.word) == ('position', 'whole run', 'optimistic')


def test_optimistic_is_worse_than_pessimistic():
    worst = worst_of(run(r=0.01, v=1.5))
    assert (worst.quantity, worst.word) == ('velocity', 'optimistic')
    assert worst_of(run(r=0.1)).word == 'pessimistic'
    assert worst_of(run(r=0.1)).quantity == 'position'
