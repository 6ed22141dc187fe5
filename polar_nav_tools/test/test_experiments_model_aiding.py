"""DVL lost for five minutes inside a polar mission of a vehicle with six degrees of freedom.

Two seeds, for mechanism; what the model brings is shown by twenty (docs/model-aiding.md). The same
with a low-cost IMU, and what is learnt: polar_nav_core/test/test_model_fallback.py.
"""

import numpy as np
import pytest

from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.evidence import aiding
from polar_nav_tools.experiments.experiment import Request, run

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def rows(tmp_path_factory):
    out = tmp_path_factory.mktemp('aiding')
    request = Request(rows='6_2_*', seeds=2)
    table = run(experiment_named('aiding'), request, out, lambda *_: None).tables[0]
    return {(row['case'], row['model']): row for row in table.rows}


def test_the_model_bounds_the_drift_of_a_noisy_accelerometer_without_fixes(rows):
    """Five minutes without DVL and fixes: at least half of the drift is gone."""
    end = {model: rows['6_2_no_fixes', model]['end'] for model in aiding.COLUMNS}
    assert end['q_c 1e-6'] < 0.5 * end['no model']


def test_covariances_are_honest_at_the_end_of_the_gap(rows):
    assert [key for key, row in rows.items() if '*' in str(row['nees'])] == []


def test_before_the_gap_the_model_costs_nothing(rows):
    for case in ('6_2_fixes', '6_2_no_fixes'):
        assert rows[case, 'default q_c']['before'] < 1.1 * rows[case, 'no model']['before']


def test_the_gap_has_no_ping_and_if_so_no_fix():
    cases = {case.name: case for case in aiding.cases(0.0)}
    world = cases['6_2_fixes'].scene.make(0)
    first, last = (world.truth.start_ns + round(t * 1e9) for t in aiding.GAP_S)
    for name in ('6_2_fixes', '6_2_no_fixes'):
        inputs = cases[name].shape(world).inputs
        valid = inputs.dvl_stamps_ns[inputs.dvl_valid]
        assert not np.any((valid >= first) & (valid < last))
        fixes = [f for f in inputs.fixes if first <= f.validity_ns < last]
        assert bool(fixes) == (name == '6_2_fixes')
        assert len(inputs.control_stamps_ns) == 9200
