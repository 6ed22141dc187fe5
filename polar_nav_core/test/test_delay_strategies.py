"""Late fixes: `rewind` against the same events in order, all strategies against one another."""

import dataclasses

import numpy as np
import pytest
from closed_loop import World, run
from hypothesis import given, settings
from hypothesis import strategies as st

from polar_nav_core import grid
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.engine.strategies import STRATEGIES
from polar_nav_core.engine.verdicts import Verdict


@pytest.fixture(scope='module')
def world():
    return World(30.0)


def params(world, delay_handling, **changes):
    values = {'noise_adaptation': 'adaptive_r', 'gate_probability': 0.999, **changes}
    return world.params(configuration='custom', delay_handling=delay_handling, **values)


def sensors(world):
    rng = np.random.default_rng(1)
    return [*world.imu(), *world.dvl(rng=rng), *world.depth(rng=rng)]


def last_estimate(out):
    return [o for o in out if isinstance(o, Estimate)][-1]


def in_order(fixes):
    """One of each fix, received when it is valid."""
    once = {f.sequence: f for f in fixes}
    return [dataclasses.replace(f, receive_ns=f.validity_ns) for f in once.values()]


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.data())
def test_rewind_equals_in_order_processing_to_the_bit(world, data):
    """Random delays up to 12 s, losses, duplicates, outliers, any order of arrival."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    fixes = []
    for f in world.fixes(0.7, 0.0, rng=rng):
        if rng.random() < 0.3:
            continue
        delay_ns = int(rng.uniform(0.0, 12.0) * 1e9)
        outlier = 50.0 if rng.random() < 0.1 else 0.0
        late = dataclasses.replace(f, receive_ns=f.validity_ns + delay_ns, r_e=f.r_e + outlier)
        if late.receive_ns < world.stamps[-1]:
            fixes.append(late)
            if rng.random() < 0.2:
                again = dataclasses.replace(
                    late, receive_ns=late.receive_ns + 10**8, arrival=10**6
                )
                fixes.append(again)
    got = run(Engine(params(world, 'rewind')), sensors(world) + fixes)
    expected = run(Engine(params(world, 'ignore')), sensors(world) + in_order(fixes))
    a, b = last_estimate(got), last_estimate(expected)
    assert a.stamp_ns == b.stamp_ns
    for name in ('r_e', 'v_G', 'C_b_G', 'P', 'gyro_bias_b', 'dvl_markov_m'):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
    final = {}
    for r in (o for o in got if isinstance(o, Receipt) and o.verdict is not Verdict.DUPLICATE):
        assert r.revision == (final[r.sequence].revision + 1 if r.sequence in final else 0)
        final[r.sequence] = r
    wanted = {r.sequence: r.verdict for r in expected if isinstance(r, Receipt)}
    assert {k: r.verdict for k, r in final.items()} == wanted


def test_verdict_counts_take_the_last_revision(world):
    """An outlier passes a wide gate; the good fix before it, coming later, shuts it out."""
    good, bad = world.fixes(1.0, 0.0, sigma=0.5)[2:4]
    aside_e = grid.ecef_to_grid(bad.r_e)[0] * 12.0
    bad = dataclasses.replace(bad, r_e=bad.r_e + aside_e, receive_ns=bad.validity_ns + 10**8)
    good = dataclasses.replace(good, receive_ns=bad.receive_ns + 10**9)
    engine = Engine(params(world, 'rewind', noise_adaptation='none', gate_probability=0.99))
    out = run(engine, [*world.imu(), *world.dvl(), *world.depth(), bad, good])
    told = [(r.sequence, r.verdict.name, r.revision) for r in out if isinstance(r, Receipt)]
    assert told == [
        (bad.sequence, 'FUSED', 0),
        (good.sequence, 'FUSED', 0),
        (bad.sequence, 'GATED', 1),
    ]
    assert {v.name: n for v, n in engine.verdicts.items() if n} == {
        'FUSED': 1,
        'GATED': 1,
    }
    assert last_estimate(out).fixes_fused == 1


@pytest.mark.parametrize('name', [n for n in STRATEGIES if n != 'ignore'])
def test_every_delay_aware_strategy_is_near_the_exact_one(world, name):
    """With the paper's sensors nothing visible is lost: within a tenth of the own sigma."""
    fixes = world.fixes(1.0, lambda i: 2.0 + 0.3 * (i % 4), rng=np.random.default_rng(3))
    exact = last_estimate(run(Engine(params(world, 'rewind')), sensors(world) + fixes))
    other = last_estimate(run(Engine(params(world, name)), sensors(world) + fixes))
    sigma = np.sqrt(np.diagonal(exact.P)[6:9])
    assert np.all(np.abs(other.r_e - exact.r_e) < 0.1 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diagonal(other.P)[6:9]), sigma, rtol=0.1)


def test_history_is_bounded(world):
    engine = Engine(params(world, 'rewind', max_delay_s=5.0, history_s=6.0))
    fixes = world.fixes(1.0, 4.0, rng=np.random.default_rng(3))
    run(engine, sensors(world) + fixes)
    fusion = engine.fusion
    log, streams = fusion.filter.log, fusion.filter.streams
    assert len(log.snapshot_flat) < 6.0 * 1.3 * 2 + 5
    assert len(streams.imu_stamps) < 6.0 * 1.3 * 250
    assert len(fusion._back._fixes) < 6.0 * 2.1
    reach_s = (fusion.filter.stamp_ns - fusion.oldest_ns()) * 1e-9
    assert 6.0 <= reach_s < 7.1


def test_going_back_ends_with_a_test_of_the_covariance(world):
    engine = Engine(params(world, 'rewind', gate_probability=1.0, noise_adaptation='none'))
    run(engine, [*world.imu(), *world.depth()])
    f = engine.fusion.filter
    # Indefinite, with a diagonal like any other, in all that can be gone back to.
    start = (f.state.P.ctypes.data - f.state.flat.ctypes.data) // 8
    size = f.state.P.size
    for snapshot in f.log.snapshot_flat:
        P = snapshot[start : start + size].reshape(f.state.P.shape)
        P[0, 1] = P[1, 0] = 2.0 * np.sqrt(P[0, 0] * P[1, 1])
    fix = world.fixes(1.0, lambda _: 0.2)[-1]
    late = dataclasses.replace(fix, receive_ns=f.stamp_ns + 1)
    receipts = [r for r in engine.process(late) if isinstance(r, Receipt)]
    assert [r.verdict for r in receipts] == [Verdict.NOT_READY]
    assert 'covariance of the filter' in engine.restored.why
    assert engine.navigating
    assert np.isfinite(engine.fusion.filter.state.P).all()
