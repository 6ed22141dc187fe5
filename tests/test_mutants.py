"""Mutants of the most important modules of the core are killed by the fast tests near them."""

import pytest
from mutants import MODULES, SAMPLE, SMALL, equivalents, judge, path_of


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize('module', MODULES)
def test_nine_of_ten_mutants_are_killed(module):
    tally = judge(module)
    assert tally.sampled == SMALL.get(module, SAMPLE)
    assert tally.enough, str(tally)


@pytest.mark.parametrize('module', MODULES)
def test_what_was_judged_stands_in_the_module(module):
    """A sentence about a line that is there no more is to go."""
    lines = {line.strip() for line in path_of(module).read_text(encoding='utf-8').splitlines()}
    assert [was for was, _ in equivalents(module) if was not in lines] == []
