"""A bag recorded at 1x is the one recorded as fast as possible: same estimates, same scores."""

from __future__ import annotations

import json

import pytest
from live_support import DEMO_SECONDS, polar

pytestmark = [pytest.mark.live, pytest.mark.paced, pytest.mark.slow, pytest.mark.timeout(600)]


def test_real_time_gives_what_lockstep_gives(finished_demo, tmp_path):
    options = ('--pace', 'realtime', '--duration', DEMO_SECONDS, '--bag', tmp_path / 'bag')
    done = polar('demo', *options, '--json', timeout=500.0)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    # At the pace of the clock, and not before the graph was complete.
    assert figures['wall_s']['graph'] > DEMO_SECONDS
    assert figures['counts_equal'] is True
    assert figures['verify']['equal'] is True
    lockstep = finished_demo.figures
    for topic, digests in figures['verify']['sha256'].items():
        assert digests['live'] == lockstep['verify']['sha256'][topic]['live'], topic
    assert figures['algorithms'] == lockstep['algorithms']
    counts = {t: c['recorded'] for t, c in figures['counts'].items()}
    expected = {t: c['recorded'] for t, c in lockstep['counts'].items()}
    # Outside lockstep the first message of each topic stands there, for a restart.
    first = counts.pop('/follower/nav/clock') - expected.pop('/follower/nav/clock')
    assert first == 4, 'IMU, DVL, depth, packets'
    assert counts == expected
