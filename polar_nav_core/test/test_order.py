"""Names that users read stand for the numbers that kernels are compiled with."""

from polar_nav_core import order
from polar_nav_core.engine.events import Rank
from polar_nav_core.engine.outputs import LOCAL_DOF


def test_sources_of_local_statistics_are_rows_of_the_tally():
    assert {name: row for row, name in enumerate(LOCAL_DOF)} == {
        'dvl': order.DVL_ROW,
        'depth': order.DEPTH_ROW,
    }
    assert len(LOCAL_DOF) == order.FIX_ROW


def test_robust_methods_have_the_index_that_kernels_know():
    found = {name: order.ROBUST_FIXES.index(name) for name in order.ROBUST_FIXES}
    assert found == {
        'none': order.ROBUST_NONE,
        'huber': order.ROBUST_HUBER,
        'mahalanobis': order.ROBUST_MAHALANOBIS,
    }


def test_every_rank_is_a_place_of_its_own_in_one_order():
    assert [rank.name for rank in sorted(Rank)] == [
        'IMU', 'CONTROL', 'DEPTH', 'DVL', 'HEADING', 'FIX', 'COMMAND',
    ]  # fmt: skip
