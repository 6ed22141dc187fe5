"""Bags of another version: what can be compared is compared, what cannot is said."""

import dataclasses
import re
from pathlib import Path

import pytest

pytest.importorskip('rclpy')

from polar_nav_tools.bags import BagError, BagWriter, open_bag
from polar_nav_tools.replay import verification
from polar_nav_tools.replay.verification import verify

REFERENCE = Path(__file__).parents[2] / 'bags' / 'reference'
STATE = '/follower/nav/state'
WANTED = (STATE, '/follower/imu/data_raw', '/run_info')


def test_estimates_of_a_version_with_other_fields_are_not_called_different(tmp_path, monkeypatch):
    monkeypatch.setattr(verification, 'ENGINE_VERSION', 1)  # that of the bag
    source = open_bag(REFERENCE)
    new = re.compile(r'\w+ (dvl|depth)_(updates|gated|nis_sum)\b')
    described = source.definition(STATE)
    has = 'dvl_nis_sum' in described.text
    lines = [line for line in described.text.splitlines() if not new.match(line)]
    old = dataclasses.replace(described, text='\n'.join(lines))
    with BagWriter(tmp_path / 'old', {}) as writer:
        for topic in WANTED:
            own = old if topic == STATE else source.definition(topic)
            writer.add_topic(topic, source.channel(topic).type, described=own)
        for record in source.records(WANTED):
            if record.topic == STATE and has:
                record = record._replace(data=record.data[:-32])  # the six numbers come last
            writer.write(record.topic, record.data, record.log_time_ns)
    with pytest.raises(BagError, match='NavState has other fields than the installed one'):
        verify(tmp_path / 'old')
