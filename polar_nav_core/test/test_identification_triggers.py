"""Window, triggers and the class that joins them: losses, order, gaps, bounds of memory."""

from dataclasses import replace

import numpy as np
import pytest
from identification_world import (
    DEPTH_Z,
    EPOCH_NS,
    PAPER,
    SECOND_NS,
    SILENT,
    Scene,
    Sensors,
    feed_log,
    identifier_of,
    polar_fixes,
    sail,
)
from numpy.testing import assert_array_equal
from scipy.stats import chi2

from polar_nav_core.attitude import matrix_from_euler
from polar_nav_core.errors import ConfigError
from polar_nav_core.identification.identifier import Identifier
from polar_nav_core.identification.params import IdentificationParams
from polar_nav_core.identification.result import IdentificationVerdict as Verdict
from polar_nav_core.identification.triggers import Trigger, mean_nis_bound
from polar_nav_core.identification.window import PositionFix, make_window, position_fix

PARAMS = IdentificationParams()
SHORT = Scene(duration=300.0)
FULL = Sensors()


def fixes_of(scene=SHORT, sensors=FULL):
    return [position_fix(ns, polar, DEPTH_Z) for ns, polar in polar_fixes(sail(scene), sensors)]


def with_log(scene=SHORT, sensors=FULL, **changes):
    identifier = Identifier(replace(PARAMS, **changes))
    feed_log(identifier, sail(scene), sensors)
    return identifier


def same(a, b):
    assert_array_equal(a.values, b.values)
    assert_array_equal(a.covariance, b.covariance)
    assert (a.verdict, a.reason, a.fixes) == (b.verdict, b.reason, b.fixes)


def test_order_of_arrival_changes_no_bit():
    fixes = fixes_of()
    in_order, shuffled = with_log(), with_log()
    for fix in fixes:
        in_order.add_fix(fix)
    for k in np.random.default_rng(1).permutation(len(fixes)):
        shuffled.add_fix(fixes[k])
    for method in ('robust', 'published'):
        same(*(i.identify(0, 'offline', method) for i in (in_order, shuffled)))


def test_a_repeated_fix_counts_once():
    once, twice = with_log(), with_log()
    for fix in fixes_of():
        once.add_fix(fix)
        twice.add_fix(fix)
        twice.add_fix(replace(fix, x=fix.x + 100.0))
    assert once.fixes == twice.fixes
    same(once.identify(0, 'offline'), twice.identify(0, 'offline'))


@pytest.mark.parametrize('loss', [0.3, 0.6])
def test_losses_bias_nothing(loss):
    full = identifier_of(PAPER, SILENT).identify(0, 'offline', 'robust')
    lossy = identifier_of(PAPER, replace(SILENT, loss=loss)).identify(0, 'offline', 'robust')
    assert lossy.fixes < (1.1 - loss) * full.fixes
    assert np.abs(lossy.values - full.values)[:2].max() < 0.2
    assert np.abs(lossy.values - full.values)[2:4].max() < 0.001
    # The published sum takes the true intervals too: left Euler over holes is coarser.
    rough = identifier_of(PAPER, replace(SILENT, loss=loss)).identify(0, 'offline', 'published')
    assert np.abs(rough.values - [25.0, 19.0, 0.4, 0.25])[2:].max() < 0.03


def test_the_newest_fixes_are_the_window():
    identifier = with_log(identify_fixes=50, identify_least_fixes=40)
    fixes = fixes_of()
    for fix in fixes[::-1]:
        identifier.add_fix(fix)
    window = identifier.window()
    assert window.fixes == 50
    assert window.validity_ns[-1] == fixes[-1].validity_ns
    assert window.validity_ns[0] == fixes[-50].validity_ns
    direct = make_window(fixes, with_log()._log(), most=30, longest_gap_s=5.0)
    assert_array_equal(direct.validity_ns, window.validity_ns[-30:])


def test_fixes_without_log_around_them_are_left_out():
    identifier = with_log()
    fixes = fixes_of()
    before = replace(fixes[0], validity_ns=EPOCH_NS - 60 * SECOND_NS)
    after = replace(fixes[0], validity_ns=EPOCH_NS + 400 * SECOND_NS)
    for fix in (before, *fixes, after):
        identifier.add_fix(fix)
    window = identifier.window()
    assert window.fixes == len(fixes) == identifier.fixes - 2


def test_only_what_follows_a_long_gap_of_the_log_is_used():
    truth, fixes = sail(SHORT), fixes_of()
    short, long = Identifier(PARAMS), Identifier(PARAMS)
    for identifier, gap in ((short, 4.0), (long, 6.0)):
        for k, t in enumerate(truth.t):
            if not 100.0 <= t < 100.0 + gap:
                stamp_ns = EPOCH_NS + round(t * 1e9)
                identifier.add_heading(stamp_ns, truth.psi[k], 0.0, truth.yaw_rate[k])
            identifier.add_control(stamp_ns, np.array([truth.force[k], 0.0, 0.0]))
        for fix in fixes:
            identifier.add_fix(fix)
    assert short.window().fixes == len(fixes)
    assert np.diff(short.window().seconds).max() <= 0.25 + 1e-9
    window = long.window()
    assert window.fixes < len(fixes)
    assert window.validity_ns[0] >= EPOCH_NS + 105.9 * SECOND_NS


def test_every_fix_is_a_node_at_its_own_nanosecond():
    window = identifier_of(SHORT, replace(SILENT, first=10.0123456)).window()
    at = window.validity_ns - window.validity_ns[0]
    np.testing.assert_allclose(window.seconds[window.node], at * 1e-9, rtol=0, atol=1e-12)
    truth = sail(SHORT)
    when = (window.validity_ns - EPOCH_NS) * 1e-9
    held = truth.force[np.floor(when * 10.0 + 1e-6).astype(int)]
    assert_array_equal(window.force[window.node], held)  # thrust holds until the next
    np.testing.assert_allclose(
        window.psi[window.node], np.interp(when, truth.t, truth.psi), atol=1e-6
    )


def test_too_few_fixes_and_none_at_all():
    empty = Identifier(PARAMS).identify(7, 'command')
    assert empty.verdict is Verdict.TOO_FEW_FIXES
    assert (empty.stamp_ns, empty.trigger, empty.fixes) == (7, 'command', 0)
    assert np.isnan(empty.values).all()
    few = identifier_of(Scene(duration=60.0)).identify(0, 'nis')
    assert few.verdict is Verdict.TOO_FEW_FIXES
    assert '20 fixes' in few.reason
    assert 'least 40' in few.reason


def test_what_is_not_finite_is_left_out():
    identifier = with_log()
    for k, fix in enumerate(fixes_of()):
        identifier.add_fix(replace(fix, x=np.nan) if k % 2 else fix, nis=np.inf)
    identifier.add_heading(EPOCH_NS + 301 * SECOND_NS, np.nan, 0.0, 0.0)
    identifier.add_control(EPOCH_NS + 301 * SECOND_NS, np.array([np.inf, 0.0, 0.0]))
    assert identifier.fixes == len(fixes_of()[::2])
    assert np.isnan(identifier.mean_nis)
    assert np.isfinite(identifier.window().force).all()


def test_memory_is_bounded_by_the_window():
    identifier = Identifier(replace(PARAMS, identify_fixes=20, identify_least_fixes=10))
    for k in range(20000):
        stamp_ns = EPOCH_NS + k * 100_000_000
        identifier.add_heading(stamp_ns, 0.001 * k, 0.0, 0.01)
        identifier.add_control(stamp_ns, np.array([50.0, 0.0, 0.0]))
        if k % 25 == 24:
            identifier.add_fix(PositionFix(stamp_ns, 1.0, 2.0, np.eye(2)))
    assert identifier.fixes == 20
    assert len(identifier._attitude) < 20 * 25 + 100 + 700
    assert len(identifier._force) == len(identifier._attitude)
    window = identifier.window()
    assert window.fixes == 20
    assert window.seconds[0] == pytest.approx(-10.0, abs=0.2)
    lonely = Identifier(replace(PARAMS, identify_window_s=20.0))
    for k in range(5000):
        lonely.add_heading(EPOCH_NS + k * 100_000_000, 0.0, 0.0, 0.0)
    assert len(lonely._attitude) < 400 + 700


def test_attitude_is_kept_ten_times_a_second():
    identifier = Identifier(PARAMS)
    for k in range(1000):
        C_b_G = matrix_from_euler(0.1, 0.2, 0.3)
        identifier.add_attitude(EPOCH_NS + k * 10_000_000, C_b_G, np.array([0.0, 0.0, 0.4]))
    assert len(identifier._attitude) == 100
    _, psi, pitch, rate = identifier._attitude[50]
    x_G = C_b_G[:, 0]
    assert psi == pytest.approx(np.arctan2(x_G[1], x_G[0]))
    assert pitch == pytest.approx(-np.arcsin(x_G[2]))  # nose down is positive
    assert rate == 0.4


def test_count_trigger_comes_with_a_full_window_and_then_at_its_rate():
    trigger = Trigger(replace(PARAMS, identify_fixes=50, identify_every=20))
    at = []
    for k in range(1, 121):
        trigger.add_fix()
        if trigger.due():
            at.append((k, trigger.due()))
            trigger.done()
    assert at == [(50, 'count'), (70, 'count'), (90, 'count'), (110, 'count')]


def test_nis_trigger_needs_many_and_not_one():
    bound = mean_nis_bound(20, 0.99)
    assert bound == pytest.approx(chi2.ppf(0.99, 40) / 20, rel=1e-12)
    for high, fires in ((bound * 1.01, True), (bound * 0.99, False)):
        trigger = Trigger(PARAMS)
        due = []
        for _ in range(60):
            trigger.add_fix()
            trigger.add_nis(high)
            due.append(trigger.due())
        assert ('nis' in due) == fires
        if fires:
            assert due.index('nis') == PARAMS.identify_least_fixes - 1
    single = Trigger(PARAMS)
    for k in range(60):
        single.add_fix()
        single.add_nis(25.0 if k == 50 else 1.5)
        assert single.due() is None


def test_after_an_attempt_the_nis_is_gathered_anew():
    trigger = Trigger(PARAMS)
    at = []
    for k in range(1, 101):
        trigger.add_fix()
        trigger.add_nis(9.0)
        if trigger.due():
            at.append(k)
            trigger.done()
            assert np.isnan(trigger.mean_nis)
    assert at == [40, 60, 80, 100]


def test_no_trigger_where_none_is_wanted_but_a_command_works():
    identifier = with_log(identify_method='none', identify_fixes=60)
    for fix in fixes_of():
        identifier.add_fix(fix, 50.0)
    assert identifier.due() is None
    assert identifier.identify(0, 'command').method == 'robust'


def test_identifier_is_due_and_begins_to_count_anew():
    identifier = with_log(identify_fixes=60, identify_least_fixes=50, identify_every=30)
    fixes = fixes_of()
    seen = []
    for k, fix in enumerate(fixes, 1):
        identifier.add_fix(fix, 2.0)
        if identifier.due():
            seen.append((k, identifier.due(), identifier.identify(k, 'count').fixes))
    assert seen == [(60, 'count', 60), (90, 'count', 60)]


def test_parameters_that_contradict_each_other():
    with pytest.raises(ConfigError, match='identify_least_fixes: 50 is more than identify_fixes'):
        replace(PARAMS, identify_least_fixes=50, identify_fixes=40)
