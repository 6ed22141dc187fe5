"""No estimate and no receipt changes by a bit: runs compared with the frozen matrix.

Where one should change, say so in the commit and renew: ``python tests/frozen_matrix.py --renew``.
"""

import copy

import pytest

pytest.importorskip('rclpy')

import frozen_matrix
from frozen_matrix import compare, differences, drivers_apart, read, row_of, rows_of
from frozen_runs import WORLDS, in_short, run, variants_of

FAST = ('default', 'tagged none mahalanobis', 'rewind none mahalanobis')
"""Variants in the fast ring."""
LATE = 'late / default'


def test_the_matrix_has_a_row_for_each_run():
    names = {f'{world} / {variant}' for world in WORLDS for variant in variants_of(world)}
    assert set(read()['rows']) == names


@pytest.mark.parametrize('world', WORLDS)
def test_a_few_rows_of_each_world(world):
    variants = [v for v in FAST if v in variants_of(world)]
    assert compare(rows_of(world, variants)) == []


@pytest.mark.parametrize('world', ['late', 'outliers', 'station odd'])
def test_both_drivers_give_the_same_bits(world):
    assert drivers_apart(world, FAST[2:]) == []


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize('world', WORLDS)
def test_the_other_rows_of_each_world(world):
    variants = [v for v in variants_of(world) if v not in FAST]
    assert compare(rows_of(world, variants)) == []


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize('number', range(2, len(WORLDS)))
def test_both_drivers_give_the_same_bits_for_some_in_each_world(number):
    """Every second variant of a world, in the next one the others."""
    variants = [*in_short(WORLDS[number])][number % 2 :: 2]
    assert variants
    assert drivers_apart(WORLDS[number], variants) == []


@pytest.mark.long
@pytest.mark.timeout(400)
@pytest.mark.parametrize('world', WORLDS[2:])
def test_both_drivers_give_the_same_bits_in_each_world(world):
    assert drivers_apart(world, in_short(world)) == []


def test_another_machine_is_compared_by_numbers(monkeypatch):
    """To a millionth of sigma: the last bit may differ there, and nothing that can be seen."""
    row = row_of(run('late', 'default'))
    monkeypatch.setattr(frozen_matrix, 'cpu_key', lambda: {'cpu': 'another'})
    row['sha256']['estimates'] = '0'
    assert compare({LATE: row}) == []
    for change in (
        lambda at: at[1].__setitem__(0, at[1][0] + 1e-5 * at[3][0]),  # position
        lambda at: at[2].__setitem__(2, at[2][2] + 1e-5 * at[3][5]),  # velocity
        lambda at: at[3].__setitem__(1, at[3][1] * 1.00001),  # sigma
        lambda at: at[1].__setitem__(1, float('nan')),
    ):
        other = copy.deepcopy(row)
        change(other['at'][1])
        assert 'sigma apart' in compare({LATE: other})[0]
    assert compare({LATE: {**row, 'verdicts': {'FUSED': 1}}})
    assert compare({LATE: {**row, 'count': 3}})


def test_what_differs_is_named():
    row = read()['rows'][LATE]
    other = copy.deepcopy(row)
    other['sha256']['receipts'] = '0'
    found = differences(row, other, bits=True)
    assert found == ['bits of receipts', 'within 1e-06 sigma half-way and at the end']
    assert compare({'late / something': row}) == ['late / something: not in frozen_matrix.json']
