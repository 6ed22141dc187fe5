"""Many packets read at once give the fixes that they give one by one, to the last bit."""

from dataclasses import fields, replace

import numpy as np
import pytest

from polar_nav_core import earth
from polar_nav_core.link.packet import Broadcast, encode
from polar_nav_follower.measurements.fix import Packet, fix_from_packet, fixes_from_packets
from polar_nav_follower.params import FollowerParams

PARAMS = FollowerParams()
NOW_NS = 1_772_323_200_000_000_000


def broadcast(rng, number):
    A = rng.normal(size=(3, 3))
    validity_ns = NOW_NS + 2_000_000_000 * number + int(rng.integers(1_000_000_000))
    latitude, longitude = rng.uniform(1.2, 0.5 * np.pi), rng.uniform(-np.pi, np.pi)
    return Broadcast(
        source=PARAMS.leader_id,
        target=PARAMS.own_id,
        sequence=number,
        validity_ns=validity_ns,
        return_ns=validity_ns + int(rng.integers(6_000_000_000)),
        leader_r_e=np.asarray(earth.ecef_from_geodetic(latitude, longitude, -50.0)),
        leader_sigma_horizontal=rng.uniform(0.0, 30.0),
        leader_sigma_vertical=rng.uniform(0.0, 1.0),
        leader_v_G=rng.normal(size=3),
        leader_sigma_velocity=0.1,
        leader_grid_heading=rng.uniform(-np.pi, np.pi),
        leader_sigma_heading=0.01,
        r_lf_G=1e3 * rng.normal(size=3),
        r_lf_covariance_G=A @ A.T + 0.1 * np.eye(3),
        sound_speed=1450.0,
    )


def packets(rng, changes=()):
    found = []
    for n, change in enumerate([*changes, *({} for _ in range(40))]):
        b = replace(broadcast(rng, n), **change)
        received_ns = b.return_ns + int(rng.integers(10_000_000_000))
        found.append(Packet(encode(b), 'leader', n + 7, b.return_ns, received_ns))
    return found


def assert_the_same(found):
    singly = [fix_from_packet(*p[:3], n, *p[3:], PARAMS)[0] for n, p in enumerate(found)]
    together = fixes_from_packets(found, PARAMS)
    assert len(together) == len(singly)
    for a, b in zip(together, singly, strict=True):
        for field in fields(a):
            x, y = getattr(a, field.name), getattr(b, field.name)
            if isinstance(y, np.ndarray):
                np.testing.assert_array_equal(x, y)
                assert x.flags.c_contiguous
                assert x.flags.writeable == y.flags.writeable
            else:
                assert type(x) is type(y)
                assert x == y or (x != x and y != y), field.name
    return together


def test_good_packets():
    fixes = assert_the_same(packets(np.random.default_rng(1)))
    assert all(fix.refusal is None for fix in fixes)


def test_among_packets_that_hold_no_fix():
    rng = np.random.default_rng(2)
    found = packets(
        rng,
        [
            {'source': PARAMS.leader_id + 1},
            {'target': PARAMS.own_id + 1},
            {'leader_r_e': np.array([1.0, 2.0, 3.0])},
            {'leader_r_e': np.array([0.0, 6378137.0, 0.0])},  # no grid axes there
            {'version': 2},
            {'validity_ns': 0, 'return_ns': 0},
        ],
    )
    damaged = found[8]
    found[8] = damaged._replace(data=bytes([damaged.data[0] ^ 4, *damaged.data[1:]]))
    found[9] = found[9]._replace(data=found[9].data[:-1])
    found[10] = found[10]._replace(data=b'')
    fixes = assert_the_same(found)
    assert sum(fix.refusal is not None for fix in fixes) >= 7


@pytest.mark.parametrize('count', [0, 1])
def test_few(count):
    assert len(assert_the_same(packets(np.random.default_rng(3))[:count])) == count
