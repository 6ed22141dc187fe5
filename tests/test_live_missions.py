"""The two missions at full length: what ignoring the delay costs, what minding it gives."""

from __future__ import annotations

import json

import pytest
from live_support import polar

pytestmark = [pytest.mark.live, pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.mark.parametrize('mission', ['demo', 'near_pole'])
def test_second_half_of_ten_minutes(mission, tmp_path):
    done = polar('demo', '--mission', mission, '--json', '--bag', tmp_path / 'bag', timeout=850.0)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures['ok'] is True
    assert figures['duration_s'] == 600.0
    assert figures['counts']['/follower/imu/data_raw']['received'] == 60_000
    assert figures['verify']['equal'] is True
    conventional = figures['algorithms']['conventional_akf']['second_half']
    # Taking late fixes as current puts the follower where it was: speed x mean delay behind.
    assert conventional['horizontal_rms_m'] == pytest.approx(
        conventional['expected_lag_m'], rel=0.2
    )
    for name in ('modified_akf', 'default'):
        assert figures['algorithms'][name]['second_half']['horizontal_rms_m'] <= 1.0
