"""Two missions: what ignoring the delay costs, what minding it gives; whole with --long."""

from __future__ import annotations

import json

import pytest
from live_support import polar

pytestmark = [pytest.mark.live, pytest.mark.slow, pytest.mark.timeout(900)]

SECONDS = (240.0, pytest.param(600.0, marks=pytest.mark.long))
"""At either length the second half is long past the start; ten minutes are the missions' own."""


@pytest.mark.parametrize('seconds', SECONDS)
@pytest.mark.parametrize(('mission', 'way'), [('demo', ()), ('near_pole', ('--composed',))])
def test_second_half_of_a_mission(mission, way, seconds, tmp_path):
    options = ('--mission', mission, *way, '--duration', seconds, '--json')
    done = polar('demo', *options, '--bag', tmp_path / 'bag', timeout=850.0)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures['ok'] is True
    assert figures['duration_s'] == seconds
    assert figures['counts']['/follower/imu/data_raw']['received'] == 100 * seconds
    assert figures['verify']['equal'] is True
    conventional = figures['algorithms']['conventional_akf']['second_half']
    # Taking late fixes as current puts the follower where it was: speed x mean delay behind.
    assert conventional['horizontal_rms_m'] == pytest.approx(
        conventional['expected_lag_m'], rel=0.2
    )
    for name in ('modified_akf', 'default'):
        assert figures['algorithms'][name]['second_half']['horizontal_rms_m'] <= 1.0
