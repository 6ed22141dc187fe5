"""A leader's packets as a modem's driver publishes them: from bytes to a fix, live and in replay.

Written as a new user would: a mapping of the modem's topic, nothing else.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_worlds import FIXES, TRANSPONDER_LEVER_B, point, truth_of
from std_msgs.msg import UInt8MultiArray
from test_live_sources import Rows, params_of, sail, same, world

from polar_nav_core.engine.events import Fix
from polar_nav_core.errors import ConfigError
from polar_nav_core.grid import ecef_to_grid
from polar_nav_core.link.packet import Broadcast, encode
from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import Session
from polar_nav_msgs.msg import FixReceipt
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.live import Sources, Taken
from polar_nav_ros.adapters.section import Section
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.topics import RX
from polar_nav_tools.bags import open_bag
from polar_nav_tools.foreign.guess import guess
from polar_nav_tools.foreign.load import load
from polar_nav_tools.foreign.sources import open_source
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.verification import verify

MODEM = '/modem/received'
KIND = 'std_msgs/msg/UInt8MultiArray'
PACKETS = {
    'topic': MODEM,
    'type': KIND,
    'fields': {'payload': 'data'},
    'clock': 'log',
    'source': 'ship',
    'leader_id': 9,
    'own_id': 4,
}


def packets(changed: bytes = b'\n') -> Rows:
    """Packets of a ship 300 m away, 6 s after they were valid, with a modem's end of line."""
    truth, rows = truth_of(120.0), []
    for n, second in enumerate((10, 20, 28)):
        validity_ns = truth.start_ns + second * 10**9
        r_e, _ = point(truth.state(np.array([validity_ns])), TRANSPONDER_LEVER_B)
        r_lf_G = np.array([250.0, -150.0, -20.0])
        leader_r_e = r_e[0] - ecef_to_grid(r_e[0]).T @ r_lf_G
        broadcast = Broadcast(
            source=9,
            target=4,
            sequence=n,
            validity_ns=validity_ns,
            return_ns=validity_ns + 200_000_000,
            leader_r_e=leader_r_e,
            leader_sigma_horizontal=0.5,
            leader_sigma_vertical=0.1,
            leader_v_G=np.zeros(3),
            leader_sigma_velocity=0.1,
            leader_grid_heading=0.3,
            leader_sigma_heading=0.001,
            r_lf_G=r_lf_G,
            r_lf_covariance_G=np.eye(3),
            sound_speed=1440.0,
        )
        message = UInt8MultiArray(data=encode(broadcast) + changed)
        rows.append((MODEM, validity_ns + 6 * 10**9, to_bytes(message)))
    return rows


def with_modem(rows: Rows, top: dict[str, Any], extra: Rows) -> tuple[Rows, dict[str, Any]]:
    kept = [row for row in rows if row[0] != FIXES]
    top = {**top, 'fixes': [PACKETS]}
    top['parameters'] = {**top['parameters'], 'transponder_lever_b': list(TRANSPONDER_LEVER_B)}
    return sorted([*kept, *extra], key=lambda row: row[1]), top


@pytest.fixture(scope='module')
def sailed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    rows, top = with_modem(*world(), packets())
    return sail(tmp_path_factory.mktemp('modem') / 'bag', rows, top), top


@pytest.mark.slow
def test_bytes_of_a_modem_become_fixes_and_live_equals_replay(
    sailed: tuple[Path, dict[str, Any]],
) -> None:
    path, _ = sailed
    result = verify(path)
    assert result.ok, result.difference
    assert not result.problems
    assert replay(path).verdicts == {'FUSED': 3}
    bag = open_bag(path)
    receipts = [message for _, message in bag.read('/auv/nav/receipt')]
    assert [r.verdict for r in receipts] == [FixReceipt.FUSED] * 3
    assert {r.source for r in receipts} == {'ship'}
    ages = [
        r.receive_time.sec + r.receive_time.nanosec * 1e-9 - r.header.stamp.sec for r in receipts
    ]
    assert all(a >= 0.0 for a in ages)


def test_a_recording_of_the_modem_read_offline_has_the_same_fixes(
    sailed: tuple[Path, dict[str, Any]],
) -> None:
    path, top = sailed
    top = {**top, 'accept': ['gap']}
    parsed = mapping_file.from_section(Section('m', top))
    offline = load(open_source(path), parsed).inputs.fixes
    params = params_of(top)
    assert (params.leader_id, params.own_id) == (9, 4)
    sources = Sources(parsed, params)
    source = sources.of(RX)
    assert source is not None
    source.bind(UInt8MultiArray(), {})
    session = Session(params, 'auv', sources)
    live = []
    for _, message in open_bag(path).read(MODEM):
        arrival_ns = offline[len(live)].receive_ns
        stamp_ns = source.validity_ns(source.own_stamp_ns(message, arrival_ns), arrival_ns)
        live.append(session.event_of(RX, Taken(message, arrival_ns, stamp_ns)))
    assert len(offline) == len(live) == 3
    for one, other in zip(offline, live, strict=True):
        same(one, other)
        assert isinstance(one, Fix)
        assert one.receive_ns > one.validity_ns


def test_map_finds_the_topic_that_carries_packets(sailed: tuple[Path, dict[str, Any]]) -> None:
    text = guess(open_source(sailed[0]))
    assert f'- topic: {MODEM}' in text
    assert 'leader_id: 9' in text
    assert 'own_id: 4' in text


@pytest.mark.slow
def test_damaged_and_short_bytes_get_their_verdict(tmp_path: Path) -> None:
    """A modem with bit errors, and one that cuts a packet at 30 bytes."""
    good = packets()
    damaged = [(t, at, data[:-20] + bytes([data[-20] ^ 1]) + data[-19:]) for t, at, data in good]
    short = bytes(UInt8MultiArray(data=bytes(30)).data)
    cut = (MODEM, good[2][1], to_bytes(UInt8MultiArray(data=short)))
    rows, top = with_modem(*world(), [damaged[0], good[1], cut])
    path = sail(tmp_path / 'bag', rows, top)
    assert verify(path).ok
    assert replay(path).verdicts == {'BAD_CRC': 1, 'BAD_FORMAT': 1, 'FUSED': 1}


def test_a_modem_whose_messages_are_too_short_is_refused() -> None:
    _, top = world()
    top['fixes'] = [{'topic': '/seatrac/rec', 'type': 'seatrac_interfaces/msg/ModemRec'}]
    mapping = mapping_file.from_section(Section('m', top))
    with pytest.raises(ConfigError, match='carries at most 30 bytes, a packet has 57'):
        Sources(mapping, FollowerParams())
