"""Verdicts of the experiment `faults` on made-up runs, and a few real ones."""

import math
from dataclasses import replace

import numpy as np
import pytest

from polar_nav_core.engine.events import DepthSample, Fix, ImuSample
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import to_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_follower.session import Session
from polar_nav_ros.topics import STATE
from polar_nav_tools.bags import open_bag
from polar_nav_tools.experiments.catalog import experiment_named
from polar_nav_tools.experiments.hold.drive import drive
from polar_nav_tools.experiments.hold.judge import Errors, first_new, judge
from polar_nav_tools.experiments.hold.messages import start_ns_of, with_faults
from polar_nav_tools.experiments.hold.offline import write
from polar_nav_tools.experiments.hold.plan import COLUMNS, FAULTS, _world_of, plan, run_job
from polar_nav_tools.experiments.hold.random_rows import PREFIXES
from polar_nav_tools.experiments.hold.rows import ROWS, rows_named
from polar_nav_tools.experiments.hold.shown import shown_by_fixes
from polar_nav_tools.experiments.hold.table import tables
from polar_nav_tools.experiments.hold.trace import Innovation, Listener, Trace, Word
from polar_nav_tools.experiments.received import message_of
from polar_nav_tools.experiments.request import Request, Size
from polar_nav_tools.experiments.runner import tasks_of
from polar_nav_tools.experiments.station_choices import StationChoices
from polar_nav_tools.inject import faults as injected
from polar_nav_tools.inject.bag import inject_bag
from polar_nav_tools.inject.readings import NS
from polar_nav_tools.replay.by_message import replay
from polar_nav_tools.tasks.distribution import EndedWorkers

START_S, END_S, UNTIL_S = 100.0, 110.0, 300.0
TIMES = np.arange(1.0, UNTIL_S + 1.0)
FIXES = np.arange(2.0, UNTIL_S, 2.0)
WARNED = (Word(101.0, 1, 'DVL silent for 1 s'),)


def errors(off, sigma=1.0, until=UNTIL_S):
    """Errors along x with a sigma, each a number or a function of time."""
    t = TIMES[until >= TIMES]
    x = off(t) if callable(off) else np.full(len(t), off)
    s = sigma(t) if callable(sigma) else np.full(len(t), sigma)
    d = np.zeros((len(t), 3))
    d[:, 0] = x
    return Errors(t, d, np.repeat(np.asarray(s, float)[:, None], 3, axis=1))


def verdict(found, words=WARNED, level=0, ended='', end_s=END_S, seen=()):
    trace = Trace(
        found.time_s, np.zeros((0, 3)), found.sigma_G, words,
        np.full(int(UNTIL_S), level), FIXES, ended, innovations(seen),
    )  # fmt: skip
    clean = replace(Trace.nothing(''), fixes=innovations([0.0] * len(seen)))
    return judge(errors(0.5), clean, found, trace, START_S, end_s, UNTIL_S)


def innovations(z):
    """Fixes of 2 m per axis from 2 s before the fault on, 1.5 s late, off by (z, -z)."""
    return {
        ('leader', k): Innovation(START_S - 0.5 + 2 * k, (off, -off), (4.0, 4.0))
        for k, off in enumerate(z)
    }


def between(low, high, value):
    return lambda t: np.where((t >= low) & (t < high), value, 0.5)


def test_fixes_show_a_fault_when_its_best_test_has_five_sigma():
    # The first came before the fault. Each of the others adds 2 z^2 / 4: 2, 8, 12.5 and 2.
    judged = verdict(errors(between(100, 120, 5.5)), seen=[9.0, 2.0, 4.0, 5.0, 2.0])
    assert judged.shown_sigmas == pytest.approx(math.sqrt(24.5))
    assert math.isnan(judged.shown_s)
    assert judged.unsaid_since_s == 0.0
    judged = verdict(errors(between(100, 120, 5.5)), seen=[9.0, 2.0, 4.0, 5.0, 3.0])
    assert judged.shown_s == 7.5
    # Of 20 seconds beyond 5 sigma without ERROR, from 100 s to 119 s, twelve are later.
    assert (judged.verdict, judged.unsaid_s, judged.unsaid_since_s) == ('SILENT', 20.0, 12.0)


def test_the_evidence_of_fixes_is_what_a_matched_filter_has():
    """Against sampling: the statistic of a test that knows the shape has a mean of J sigmas."""
    rng = np.random.default_rng(3)
    shape = rng.normal(size=(7, 2))
    variance = rng.uniform(1.0, 4.0, size=(7, 2))
    usual = rng.normal(size=(4000, 7, 2)) * np.sqrt(variance)
    weights = shape / variance
    spread = (usual * weights).sum(axis=(1, 2)).std()
    expected = (shape * weights).sum() / spread

    def fixes(z):
        return {('l', k): Innovation(float(k), tuple(z[k]), tuple(variance[k])) for k in range(7)}

    shown = shown_by_fixes(fixes(usual[0]), fixes(usual[0] + shape), 0.0)
    assert shown.sigmas == pytest.approx(expected, rel=0.05)


def test_recovered_in_time():
    judged = verdict(errors(between(100, 150, 4.0)))
    assert (judged.verdict, judged.recovered_s, judged.worst_m) == ('recovered', 40.0, 4.0)
    assert (judged.reported_s, judged.sentence) == (1.0, 'WARN: DVL silent for 1 s')


def test_not_recovered():
    assert verdict(errors(between(100, 180, 4.0))).verdict == 'NOT RECOVERED'
    assert verdict(errors(between(100, 180, 4.0)), words=()).verdict == 'SILENT'
    assert verdict(errors(between(100, 301, 4.0))).recovered_s == math.inf
    wide = errors(0.5, sigma=lambda t: np.where(t > 100, 3.5, 1.0))
    assert verdict(wide).verdict == 'NOT RECOVERED'
    assert verdict(wide).sigma_ratio == pytest.approx(3.5)


def test_beyond_five_sigma_needs_error():
    off = errors(between(100, 120, 5.5))
    assert verdict(off).verdict == 'SILENT'
    assert verdict(off).unsaid_s == 20.0
    assert verdict(off, level=2).verdict == 'recovered'


def test_dead():
    assert verdict(errors(0.5, until=200.0)).verdict == 'DEAD'
    assert verdict(errors(0.5), ended='no state').verdict == 'DEAD'
    # A sensor that is gone for good leaves nothing to publish; it must be reported.
    assert verdict(errors(0.5, until=200.0), end_s=math.inf).verdict == 'reported'


def test_lasting_fault_is_covered_or_reported():
    assert verdict(errors(3.0), end_s=math.inf).verdict == 'reported'
    assert verdict(errors(3.0), words=(), end_s=math.inf).verdict == 'covered'
    assert verdict(errors(6.0), end_s=math.inf).verdict == 'SILENT'


def test_only_new_words_report():
    before, usual = Word(90.0, 1, 'no fix for 12 s'), Word(200.0, 2, 'depth off by 3 m')
    words = (before, Word(101.0, 1, 'no fix for 14 s'), Word(102.0, 2, 'depth off by 9 m'))
    assert first_new(words, (usual,), START_S) is None
    new = Word(103.0, 1, 'DVL off')
    assert first_new((*words, new), (usual,), START_S) == new
    long_ago = Word(5.0, 1, 'DVL off')
    assert first_new((long_ago, *words, new), (usual,), START_S) == new


def test_random_rows_are_those_of_their_numbers_and_can_be_injected():
    for prefix in PREFIXES:
        rows = rows_named(f'{prefix}1-400')
        assert len(rows) == 400
        assert rows_named(f'{prefix}7') == [rows[6]]
        mode = rows[0].mode
        known = {f.name for f in injected.FAULTS.values() if mode in f.modes}
        if prefix == 'random-no-dvl:':
            known = {name for name in known if not name.startswith('dvl_')}
        assert {one.fault.name for row in rows for one in row.injections} == known
        assert 0.2 < np.mean([len(row.injections) == 2 for row in rows]) < 0.4
        for row in rows:  # what is said of it is what `./polar inject` makes
            assert tuple(injected.parse(text) for text in row.text.split()) == row.injections
            assert row.text in row.name
            assert row.at_s == 120.0
    (large,) = rows_named('random:588')  # as drawn it is 90 km, which no packet holds
    assert [(i.fault.name, i.size) for i in large.injections] == [('packet_sigma', 1.3e4)]
    with pytest.raises(ConfigError, match="'random:x' has no number"):
        rows_named('random:x')


def test_rows_and_columns():
    assert len(ROWS) >= 40
    assert [r.name for r in rows_named('imu_2038,clock*')] == [
        'imu_2038', 'clock_step:3600', 'clock_step:-10', 'clock_step:2', 'clock_step:-2',
        'clock_step:0.4', 'clock_step:-0.3',
    ]  # fmt: skip
    with pytest.raises(ConfigError, match=r'--rows nothing.*or drawn at random: random:1-50, '):
        rows_named('nothing')
    jobs = plan(Request(rows='imu_2038,station/imu_2038'), Size(280.0, 2), COLUMNS)
    assert len(jobs) == 2 * (len(COLUMNS) + 1)
    assert experiment_named('faults') is FAULTS
    with pytest.raises(ConfigError, match='--duration'):
        plan(Request(duration_s=100.0), Size(100.0, 1), COLUMNS)


def shortened(job, seconds):
    """The job in a world that ends sooner; faults begin at 120 s, recovery has a minute."""
    scene = job.row.scene
    name = 'scenario' if job.row.scene.mode == 'station' else 'world'
    scene = replace(scene, **{name: replace(getattr(scene, name), duration_s=seconds)})
    return replace(job, row=replace(job.row, scene=scene))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_few_of_its_runs():
    rows = Request(rows='packet_indefinite')
    jobs = plan(rows, Size(280.0, 2), ('default', 'modified_akf'))
    results = [run_job(shortened(job, 200.0)) for job in jobs]
    assert {r.verdict for r in results} == {'recovered'}
    assert all(r.sentence for r in results)
    assert all(r.metrics['reported_s'] < 5.0 for r in results)
    replayed = [r for r in results if r.offline]
    assert {(r.seed, r.offline, r.equal) for r in replayed} == {(1, 'recovered', True)}
    assert len(replayed) == 2
    assert all(r.offline_sentence for r in replayed)
    table, counts, differ = tables(results)
    assert len(table.rows) == 2
    assert counts.rows[0] == {'verdict': 'recovered', 'default': 1, 'modified_akf': 1}
    assert differ.rows == ()
    assert '2 of them equal' in differ.note


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_what_a_replay_cannot_know():
    """An IMU that is silent for good: only the node's steady clock says so, within seconds."""
    (job,) = plan(Request(rows='imu_silent:inf'), Size(280.0, 1), ('default',))
    result = run_job(job)
    assert (result.verdict, result.offline, result.equal) == ('reported', 'reported', True)
    assert 'no IMU sample for 3 s' in result.sentence
    # Packets that came a minute after the last sample.
    assert 'acomms/rx TOO_LATE' in result.offline_sentence
    assert tables([result])[2].rows == ()
    other = replace(result, offline='covered', equal=False)
    (line,) = tables([other])[2].rows
    assert (line['verdict'], line['offline'], line['equal']) == ('reported', 'covered', 'NO')


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize('row', ['imu_late:5', 'packet_burnt:600', 'clock_step:-10'])
def test_a_run_is_what_a_replay_of_an_injected_bag_gives(tmp_path, row):
    """`inject` on the recording of the run without the fault, then `replay`, bit for bit."""
    (job,) = plan(Request(rows=row), Size(280.0, 1), ('default',))
    job = shortened(job, 100.0)
    made = _world_of(job.row, job.seed)
    params = FollowerParams(**to_mapping(made.world.params(output_period_s=0.5, **job.changes)))
    end_ns = start_ns_of(made.world) + 100 * NS
    clean = drive(params, made.messages, start_ns_of(made.world), end_ns)
    bag = write(tmp_path / 'clean', params, clean.record, start_ns_of(made.world))
    injection = replace(job.row.injections[0], at_s=60.0 - 0.02)  # from the first sample on
    inject_bag(open_bag(bag), [injection], tmp_path / 'faulty', job.seed)
    found = replay(open_bag(tmp_path / 'faulty'))
    messages = [
        m for m in with_faults(made.messages, [injection], job.seed) if m.reading.true_ns <= end_ns
    ]
    live = drive(params, messages, start_ns_of(made.world), end_ns + 60 * NS)
    states = [one.data for one in live.record if one.topic == STATE]
    assert len(states) > 150
    assert found.of(STATE) == states


@pytest.mark.slow
@pytest.mark.parametrize('mode', ['imu_2038', 'station/imu_2038'])
def test_messages_are_read_as_the_events_that_they_are_of(mode):
    (job,) = plan(Request(rows=mode), Size(280.0, 1), ('default',))
    made = _world_of(shortened(job, 30.0).row, 3)
    world = made.world
    engine = world.params() if mode == 'imu_2038' else world.params(StationChoices(), 0.0)
    session = Session(FollowerParams(**to_mapping(engine)), 'follower')
    events = [e for e in world.inputs.events() if e.stamp_ns < start_ns_of(made.world) + 12 * NS]
    assert {type(e) for e in events} >= {ImuSample, DepthSample, Fix}
    for event, taken in zip(events, made.messages, strict=False):
        read = session.event_of(taken.received.topic, message_of(event))
        assert read.stamp_ns == event.stamp_ns == taken.received.arrival_ns
        if isinstance(event, Fix):
            assert (read.validity_ns, read.sequence) == (event.validity_ns, event.sequence)
            if event.polar is None:
                np.testing.assert_allclose(read.r_e, event.r_e, atol=0.02)
                np.testing.assert_allclose(read.covariance_e, event.covariance_e, atol=0.1)
            else:
                np.testing.assert_allclose(read.polar.station, event.polar.station, atol=1e-9)
                assert read.polar.range == event.polar.range
            continue
        for name in ('omega_ib_b', 'f_b', 'v_m', 'covariance_m', 'depth', 'variance', 'force_b'):
            if hasattr(event, name):
                np.testing.assert_array_equal(getattr(read, name), getattr(event, name))
        if getattr(event, 'C_b_G', None) is not None:
            np.testing.assert_allclose(read.C_b_G, event.C_b_G, atol=1e-14)


def test_levels_stand_in_the_second_that_they_report():
    listener = Listener(0)
    listener.word(2 * NS, 2, 'IMU silent')  # said at the end of the second
    listener.word(3 * NS + 1, 1, 'no DVL')
    listener.word(4 * NS, 0, 'navigating')
    trace = listener.trace(6 * NS, '')
    assert trace.level.tolist() == [0, 2, 0, 1, 0, 0]
    assert [w.sentence for w in trace.words] == ['IMU silent', 'no DVL']


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_run_in_station_mode():
    (job,) = plan(Request(rows='station/imu_silent:1'), Size(280.0, 1), ('default',))
    result = run_job(shortened(job, 150.0))
    assert result.verdict in ('recovered', 'reported', 'covered')
    assert (result.offline, result.equal) == (result.verdict, True)


def test_a_run_is_named_before_it_has_a_result():
    (job,) = plan(Request(rows='imu_2038', first_seed=7), Size(280.0, 1), ('default',))
    (task,) = tasks_of([job], run_job)
    assert task.names == {'group': 'imu_2038', 'filter': 'default', 'seed': 7}
    assert 'group imu_2038, filter default, seed 7: ended 3 workers' in str(EndedWorkers(task))
