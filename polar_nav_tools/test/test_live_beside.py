"""Two sources of one quantity side by side, and positions that a filter has made already."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_worlds import DEPTH, DVL, FIXES
from test_live_sources import Rows, params_of, sail, same, world

from polar_nav_core.engine.events import Fix
from polar_nav_core.errors import ConfigError
from polar_nav_msgs.msg import FixReceipt, NavState
from polar_nav_ros.adapters import mapping_file
from polar_nav_ros.adapters.fixes import shares
from polar_nav_ros.adapters.live import Sources, Taken
from polar_nav_ros.stamps import to_ns
from polar_nav_tools.bags import open_bag
from polar_nav_tools.foreign import replay as foreign
from polar_nav_tools.foreign.load import load
from polar_nav_tools.foreign.sources import open_source
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.replay.verification import verify

pytestmark = pytest.mark.slow

OTHER_DVL, OTHER_DEPTH = '/auv/dvl2/twist', '/auv/pressure2'
SECOND_NS = 10**9


def doubled(rows: Rows, top: dict[str, Any]) -> tuple[Rows, dict[str, Any]]:
    """The same messages on second topics, too, with equal stamps."""
    again = {DVL: OTHER_DVL, DEPTH: OTHER_DEPTH}
    both = [(again[t], at, data) for t, at, data in rows if t in again]
    top = dict(top)
    top['dvl'] = [top['dvl'], top['dvl'] | {'topic': OTHER_DVL, 'sigma': 0.02}]
    top['depth'] = [top['depth'], top['depth'] | {'topic': OTHER_DEPTH, 'sigma': 0.3}]
    return sorted([*rows, *both], key=lambda row: row[1]), top


@pytest.fixture(scope='module')
def sailed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    rows, top = doubled(*world())
    late = next(k for k, r in enumerate(rows) if r[0] == OTHER_DVL and k > len(rows) // 2)
    topic, at, data = rows[late]
    rows[late] = (topic, at + 2 * SECOND_NS, data)  # comes too late: a receipt names its topic
    rows.sort(key=lambda row: row[1])
    return sail(tmp_path_factory.mktemp('beside') / 'bag', rows, top), top


def states(path: Path) -> list[NavState]:
    return [message for _, message in open_bag(path).read('/auv/nav/state')]


def test_two_sensors_of_a_kind_live_and_in_replay(sailed: tuple[Path, dict[str, Any]]) -> None:
    path, _ = sailed
    result = verify(path)
    assert result.ok, result.difference
    taken = replay(path).taken
    assert taken['/auv/dvl/data'] == taken[f'/auv/{OTHER_DVL}'] > 100
    refused = [m for _, m in open_bag(path).read('/auv/nav/receipt') if m.verdict]
    (receipt,) = refused
    assert (receipt.verdict, receipt.topic) == (FixReceipt.TOO_LATE, OTHER_DVL)


def test_both_of_a_kind_are_used(tmp_path: Path, sailed: tuple[Path, dict[str, Any]]) -> None:
    """Twice the pings of the same noise: a smaller sigma than one of them has."""
    one = sail(tmp_path / 'bag', *world())
    sigma = [np.sqrt(states(p)[-1].velocity_covariance_g[0]) for p in (one, sailed[0])]
    assert sigma[1] < sigma[0]


def test_a_recording_of_both_gives_the_estimates_of_the_live_run(
    tmp_path: Path,
) -> None:
    rows, top = doubled(*world())
    path = sail(tmp_path / 'bag', rows, top)
    parsed = mapping_file.parse(yaml.safe_dump(top | {'accept': ['gap', 'stamps_drift']}), 'm')
    offline = foreign.replay(open_source(path), parsed).estimates
    live = {to_ns(s.header.stamp): s.r_e for s in states(path)}
    common = [k for k, ns in enumerate(offline.stamp_ns.tolist()) if ns in live]
    assert len(common) > 300
    equal = [np.array_equal(offline.r_e[k], live[int(offline.stamp_ns[k])]) for k in common]
    # The node took each fix 3 ms after the recorder: one estimate lies between.
    assert equal.count(False) <= len(list(open_bag(path).read(FIXES)))


@pytest.mark.parametrize(
    ('changes', 'says'),
    [
        ({'lever_b': [0.0, 1.0, 0.0]}, 'dvl: lever_b is not the same in all of them'),
        ({'lever_b': None}, 'dvl: lever_b is not the same in all of them'),
        ({'reference': 'water'}, 'dvl: reference is not the same in all of them'),
    ],
)
def test_what_two_of_a_kind_have_in_common(changes: dict[str, Any], says: str) -> None:
    _, top = doubled(*world())
    top['dvl'][1] |= changes
    with pytest.raises(ConfigError, match=says):
        mapping_file.parse(yaml.safe_dump(top), 'm')


def test_the_same_topic_twice_is_refused() -> None:
    _, top = doubled(*world())
    for entry in top['depth']:
        entry['topic'] = OTHER_DEPTH
    top['depth'] = [*top['depth'], top['depth'][1]]
    with pytest.raises(ConfigError, match=f'{OTHER_DEPTH} stands in it twice'):
        Sources(mapping_file.parse(yaml.safe_dump(top), 'm'), params_of(world()[1]))


def test_correlated_positions_tell_as_much_as_the_whole_row_does() -> None:
    """Information of a row on a constant: that of least squares with its covariance."""
    rng = np.random.default_rng(3)
    stamps_ns = np.cumsum(rng.integers(1, 40, 30)) * SECOND_NS
    T = 25.0
    t = stamps_ns * 1e-9
    C = np.exp(-np.abs(t[:, None] - t[None]) / T)
    whole = np.ones(30) @ np.linalg.solve(C, np.ones(30))
    factors = shares(stamps_ns, T)
    assert np.sum(1.0 / factors) == pytest.approx(whole, rel=1e-12)
    np.testing.assert_array_equal(shares(stamps_ns[7:], T, int(stamps_ns[6])), factors[7:])
    assert np.isfinite(shares(np.array([5, 5, 4]), T)).all()


def test_correlated_fixes_are_the_same_live_and_offline(tmp_path: Path) -> None:
    rows, top = world()
    top['fixes'][0] |= {'correlation_s': 60.0}
    path = sail(tmp_path / 'bag', rows, top)
    assert verify(path).ok
    parsed = mapping_file.parse(yaml.safe_dump(top | {'accept': ['gap']}), 'm')
    offline = load(open_source(path), parsed).inputs.fixes
    source = Sources(parsed, params_of(top)).of(FIXES)
    assert source is not None
    found = []
    for n, (_, message) in enumerate(open_bag(path).read(FIXES)):
        if not source.bound:
            source.bind(message, {})
        arrival_ns = offline[n].receive_ns
        stamp_ns = source.validity_ns(source.own_stamp_ns(message, arrival_ns), arrival_ns)
        found.append(source.event(Taken(message, arrival_ns, stamp_ns), n))
    assert len(found) == len(offline) > 1
    for one, other in zip(offline, found, strict=True):
        same(one, other)
    first, second = (f.covariance_e for f in found if isinstance(f, Fix))
    dt = (offline[1].validity_ns - offline[0].validity_ns) * 1e-9
    np.testing.assert_allclose(second / first, 1.0 / np.tanh(dt / 120.0), rtol=0.05)
