"""The close-up: estimates at stamps of their own, fixes that came when they were valid."""

import dataclasses
import re

import pytest

from polar_nav_tools.report.example import example_input
from polar_nav_tools.report.figures.close_up import close_up

DATA = example_input(minutes=0.5)


def drawn_with(estimate_of, receipt_of):
    """Close-up of the two example runs and a third, made of the second."""
    truth, estimate, receipts = DATA.runs['modified_akf']
    third = (truth, estimate_of(estimate), [receipt_of(r) for r in receipts])
    data = dataclasses.replace(DATA, runs={**DATA.runs, 'third': third})
    return close_up(data, data.scored())


def distances(picture):
    said = picture.caption.split('Distance from the truth: ')[1]
    return {name: float(m) for name, m in re.findall(r'(\w+) ([\d.]+) m', said)}


def test_an_estimate_is_as_far_off_as_at_its_own_stamp():
    """One estimate in 2.5 s; it was drawn where it is then, beside the truth of the instant."""
    found = distances(drawn_with(lambda e: e.rows(slice(3, None, 25)), lambda r: r))
    assert found['third'] == pytest.approx(found['modified_akf'], abs=0.5)


def test_how_late_the_last_fix_came_is_of_a_run_to_which_it_came_late():
    """To a smoother each fix comes when it is valid."""
    in_time = drawn_with(lambda e: e, lambda r: dataclasses.replace(r, receive_ns=r.validity_ns))
    usual = close_up(DATA, DATA.scored())
    (late,) = re.findall(r'>([\d.]+ s) before it arrived<', usual.svg)
    assert re.findall(r'>([\d.]+ s) before it arrived<', in_time.svg) == [late]
    assert late != '0.0 s'


def test_names_of_one_spot_do_not_stand_on_one_another():
    """Each was as far from its point as its own ellipse asks: those of two could coincide."""
    names = ('modified_akf', 'third')

    def with_a_smaller_ellipse(estimate):
        P = 0.3 * estimate.P_position_G
        return dataclasses.replace(estimate, P_position_G=P, r_e=estimate.r_e + 0.1)

    svg = drawn_with(with_a_smaller_ellipse, lambda r: r).svg
    lines = [
        float(y)
        for name in names
        for y in re.findall(rf'y="([\d.]+)"[^>]*>{name}, [\d.]+ m off<', svg)
    ]
    assert len(lines) == 2
    assert abs(lines[0] - lines[1]) > 12.0
