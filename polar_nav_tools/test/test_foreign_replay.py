"""A bag of other topics, types, axes and units gives the estimates of the native replay."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from foreign_samples import (
    DVL,
    DVL_RPY_DEG,
    FIXES,
    IMU,
    MAPPING,
    REFERENCE,
    TRUTH,
    Message,
    engine_parameters,
    recording,
    write,
)

from polar_nav_core.errors import ConfigError, PolarNavError
from polar_nav_ros.adapters import mapping_file, rotations
from polar_nav_ros.adapters.section import Section
from polar_nav_tools.analysis.analyse import analyse
from polar_nav_tools.bags import BagError, open_bag
from polar_nav_tools.bags.arrays import estimates_from_cdr, load_truth
from polar_nav_tools.foreign.guess import guess
from polar_nav_tools.foreign.guess_noise import Choices
from polar_nav_tools.foreign.load import load
from polar_nav_tools.foreign.replay import ForeignRun, replay, summary
from polar_nav_tools.foreign.replay import write as write_run
from polar_nav_tools.foreign.sources import open_source, read_table
from polar_nav_tools.replay.by_message import replay as native_replay
from polar_nav_tools.series.vehicle import EstimateSeries

KINDS = {'mcap': 'theirs', 'sqlite3': 'theirs_db3', 'ros1': 'theirs.bag'}


@pytest.fixture(scope='module')
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same recording in three formats."""
    folder = tmp_path_factory.mktemp('foreign')
    return {kind: write(folder / name, kind) for kind, name in KINDS.items()}


@pytest.fixture(scope='module')
def native() -> EstimateSeries:
    """What the project's own replay makes of the same messages."""
    result = native_replay(recording().inputs)
    return estimates_from_cdr(result.of('nav/state'), 'follower')


def mapped(changes: dict[str, object] | None = None) -> mapping_file.Mapping:
    """The mapping of the foreign bag with the parameters of the reference."""
    top = yaml.safe_load(MAPPING) | {'parameters': engine_parameters()} | (changes or {})
    return mapping_file.from_section(Section('mapping.yaml', top))


@pytest.fixture(scope='module')
def runs(bags: dict[str, Path]) -> dict[str, ForeignRun]:
    """One run per format."""
    return {
        kind: replay(open_source(path), mapped(), messages=True) for kind, path in bags.items()
    }


@pytest.mark.parametrize('kind', KINDS)
def test_the_estimates_are_those_of_the_native_replay(
    runs: dict[str, ForeignRun], native: EstimateSeries, kind: str
) -> None:
    """Rounding of units, axes and frames is all that differs: ECEF is good to 1e-9 m."""
    found = runs[kind].estimates
    assert np.array_equal(found.stamp_ns, native.stamp_ns)
    assert np.abs(found.r_e - native.r_e).max() < 1e-6
    assert np.abs(found.v_G - native.v_G).max() < 1e-9
    assert np.abs(found.C_b_G - native.C_b_G).max() < 1e-10
    assert np.allclose(found.P_position_G, native.P_position_G, rtol=1e-7, atol=0.0)
    assert runs[kind].verdicts == {'FUSED': len(recording().fixes)}


def test_three_formats_give_the_same_bytes(runs: dict[str, ForeignRun]) -> None:
    """MCAP, sqlite3 and ROS 1 hold the same numbers, so the outputs are equal bit for bit."""
    first, *others = (summary(run)['sha256'] for run in runs.values())
    assert all(other == first for other in others)


def test_the_reference_is_mapped(runs: dict[str, ForeignRun]) -> None:
    """Odometry in a tangent frame gives the positions and attitudes of the truth back."""
    truth, native = runs['mcap'].loaded.truth, recording().truth
    assert truth is not None
    same = native.rows(np.arange(0, len(native), 10))
    assert np.array_equal(truth.stamp_ns, same.stamp_ns)
    assert np.abs(truth.r_e - same.r_e).max() < 1e-6
    assert np.abs(truth.C_b_G - same.C_b_G).max() < 1e-12
    assert np.abs(truth.v_G - same.v_G).max() < 1e-12
    compared = runs['mcap'].comparison()
    assert compared is not None
    assert compared.table().records()[0]['horizontal_second_half'] < 2.0


def test_the_outputs_are_a_bag_that_scores(runs: dict[str, ForeignRun], tmp_path: Path) -> None:
    """`polar score --recorded` takes the bag that was written."""
    run = runs['mcap']
    path = write_run(tmp_path / 'out', run)
    bag = open_bag(path)
    assert bag.is_complete
    assert len(load_truth(bag, 'follower')) == len(run.loaded.truth or ())
    analysis = analyse(bag, (), live=True)
    (one,) = analysis.comparison.table().records()
    compared = run.comparison()
    assert compared is not None
    assert one['r_x'] == compared.table().records()[0]['r_x']


def test_a_mounting_that_is_not_stated_is_seen(bags: dict[str, Path]) -> None:
    """The mapping matters: a DVL taken as straight gives other estimates."""
    top = yaml.safe_load(MAPPING)
    turned = replay(
        open_source(bags['mcap']), mapped({'dvl': {**top['dvl'], 'rotation': 'frd'}})
    ).estimates
    straight = replay(open_source(bags['mcap']), mapped()).estimates
    assert np.abs(turned.v_G - straight.v_G).max() > 0.1


def test_covariances_turn_with_their_instrument(tmp_path: Path) -> None:
    """An uneven covariance in instrument axes becomes C P C' in the body's."""
    P = np.diag([1e-4, 4e-4, 9e-4])

    def uneven(message: Message) -> Message:
        topic, kind, log_ns, m = message
        return topic, kind, log_ns, replace(m, velocity_covar=P.ravel()) if topic == DVL else m

    inputs = load(open_source(write(tmp_path / 'uneven', change=uneven)), mapped()).inputs
    C = rotations.from_rpy_deg(DVL_RPY_DEG)
    assert np.allclose(inputs.dvl_covariance_m, C @ P @ C.T, rtol=0.0, atol=1e-18)


def test_stated_delays_and_offsets(bags: dict[str, Path]) -> None:
    """`delay_s` places reception after validity; `time_offset_s` shifts stamps."""
    top = yaml.safe_load(MAPPING)
    fix = {**top['fixes'][0], 'delay_s': 3.5, 'time_offset_s': -0.25}
    run = replay(open_source(bags['mcap']), mapped({'fixes': [fix]}))
    for ours, theirs in zip(run.loaded.inputs.fixes, recording().fixes, strict=True):
        assert ours.validity_ns == theirs.validity_ns - 250_000_000
        assert ours.receive_ns == ours.validity_ns + 3_500_000_000


def test_own_bag_by_mapping_is_the_native_replay(native: EstimateSeries) -> None:
    """Acoustic packets and this project's messages through the same door."""
    top = {
        'imu': {'topic': '/follower/imu/data_raw'},
        'dvl': {'topic': '/follower/dvl/data'},
        'depth': {'topic': '/follower/depth/data'},
        'fixes': [{'topic': '/follower/acomms/rx'}],
        'parameters': engine_parameters(),
    }
    run = replay(open_source(REFERENCE), mapping_file.from_section(Section('m', top)))
    found = run.estimates
    assert np.array_equal(found.r_e, native.r_e)
    assert np.array_equal(found.P_attitude_G, native.P_attitude_G)


def test_usbl_and_leader_are_a_fix() -> None:
    """UsblFix with the leader's odometry lies within its sigma of the packets' positions."""
    top = {
        'imu': {'topic': '/follower/imu/data_raw'},
        'dvl': {'topic': '/follower/dvl/data'},
        'depth': {'topic': '/follower/depth/data'},
        'fixes': [
            {
                'topic': '/leader/usbl/fix',
                'delay_s': 2.0,
                'leader': {'topic': '/leader/truth'},
            }
        ],
        'parameters': engine_parameters(),
    }
    run = replay(open_source(REFERENCE), mapping_file.from_section(Section('m', top)))
    fixes = run.loaded.inputs.fixes
    assert len(fixes) >= 13
    truth = recording().truth
    for fix in fixes:
        k = int(np.searchsorted(truth.stamp_ns, fix.validity_ns))
        if k == len(truth):
            continue
        error = fix.r_e - truth.r_e[k]
        assert error @ np.linalg.solve(fix.covariance_e, error) < 25.0


def test_a_guessed_mapping_has_axes_and_units(bags: dict[str, Path]) -> None:
    """Types, names and gravity give roles; what is missing is marked, and the text is YAML."""
    text = guess(open_source(bags['mcap']))
    top = yaml.safe_load(text)
    assert 'FILL IN' in text
    assert top['dvl']['topic'] == DVL
    assert top['dvl']['rotation'] == 'frd'
    assert top['fixes'][0]['topic'] == FIXES
    assert top['truth']['topic'] == TRUTH
    # The IMU's type is nobody's: its fields are shown, and only a person can say what they are.
    assert top['imu']['topic'] == '/FILL/IN'
    assert f'# {IMU} (acme_msgs/msg/Inertial, 3000 messages)' in text
    assert 'turn_rate_deg.forward' in text
    # What is to be filled in refuses the run until it is.
    with pytest.raises(ConfigError, match=r'imu: topic: is still to be filled in'):
        mapping_file.from_section(Section('m', top))
    top['imu']['topic'] = IMU
    with pytest.raises(ConfigError, match=r'fixes\[0\]: correlation_s: is still to be filled in'):
        mapping_file.from_section(Section('m', top))
    top['fixes'][0]['correlation_s'] = 0.0
    with pytest.raises(ConfigError, match=r'fixes\[0\]: frame: is still to be filled in'):
        mapping_file.from_section(Section('m', top))
    known = Choices(imu='stim300', dvl='workhorse_1200')
    own = yaml.safe_load(guess(open_source(REFERENCE), known))
    assert own['imu']['rotation'] == 'flu'
    assert own['imu']['accel_unit'] == 'm/s^2'
    assert own['imu']['gyro_unit'] == 'rad/s'
    assert own['fixes'][0]['topic'] == '/follower/acomms/rx'
    run = replay(open_source(REFERENCE), mapping_file.from_section(Section('m', own)))
    assert run.verdicts['FUSED'] > 0


def test_a_definition_that_the_bag_lacks_is_bundled(tmp_path: Path) -> None:
    """Old sqlite3 bags hold bytes without definitions."""
    import sqlite3

    path = write(tmp_path / 'old', 'sqlite3')
    with sqlite3.connect(path / 'old.db3') as base:
        base.execute("update message_definitions set encoded_message_definition=''")
        base.execute('delete from message_definitions')
    base.close()
    source = open_source(path)
    table = read_table(source, DVL, ('velocity.x', 'velocity_mode'))
    assert len(table) == len(recording().dvl)
    assert table.constants['DVL_MODE_BOTTOM'] == 1
    with pytest.raises(BagError, match='does not describe acme_msgs/msg/Inertial'):
        read_table(source, IMU, ('temperature',))


def test_no_bag_is_an_error_with_its_name(tmp_path: Path) -> None:
    """Missing and broken files are one sentence."""
    with pytest.raises(BagError, match=r'nothing\.bag: no such file'):
        open_source(tmp_path / 'nothing.bag')
    broken = tmp_path / 'broken.bag'
    for content, says in [
        (b'', 'is empty'),
        (b'#ROSBAG V2.0\n' + b'\0' * 40, r'this ROS 1 bag is damaged .*`rosbag reindex`'),
        (b'\x89MCAP0\r\nand more', r"is not a ROS 1 bag \(it begins with b'\\x89MCAP"),
    ]:
        broken.write_bytes(content)
        with pytest.raises(BagError, match=rf'broken\.bag:? {says}'):
            open_source(broken)


@pytest.mark.parametrize('kind', ['sqlite3', 'ros1'])
def test_a_bag_that_was_cut_off_says_what_may_help(
    bags: dict[str, Path], tmp_path: Path, kind: str
) -> None:
    """And is left as it was."""
    whole = bags[kind]
    cut = tmp_path / whole.name
    shutil.copytree(whole, cut) if whole.is_dir() else shutil.copy(whole, cut)
    file = cut if kind == 'ros1' else next(cut.glob('*.db3'))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    before = file.read_bytes()
    says = {'sqlite3': 'sqlite3 is damaged .*recover', 'ros1': 'ROS 1 bag is damaged .*reindex'}
    with pytest.raises(BagError, match=says[kind]):
        open_source(cut)
    assert file.read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize('kind', KINDS)
def test_mutated_bags_give_sentences(bags: dict[str, Path], tmp_path: Path, kind: str) -> None:
    """Cut off or changed bytes: figures or the tool's own error, never another one."""
    whole = bags[kind]
    file = whole if kind == 'ros1' else next(p for p in whole.iterdir() if p.suffix != '.yaml')
    data = file.read_bytes()
    rng = np.random.default_rng(7)
    refused = 0
    for i in range(8):
        bad = bytearray(data)
        for at in rng.integers(0, len(bad), (1, 50)[i % 2]):
            bad[at] = rng.integers(256)
        if i % 4 == 3:
            bad = bad[: rng.integers(len(bad))]
        folder = tmp_path / str(i)
        folder.mkdir()
        for other in [] if kind == 'ros1' else whole.iterdir():
            (folder / other.name).write_bytes(other.read_bytes())
        (folder / file.name).write_bytes(bad)
        try:
            source = open_source(folder / file.name if kind == 'ros1' else folder)
            guess(source)
            load(source, mapped())
        except PolarNavError:
            refused += 1
    assert refused > 0


def test_a_start_from_navsatfix_and_a_stated_heading() -> None:
    """Position from the topic, level from gravity, velocity from the DVL; fixes from the same."""
    truth = recording().truth
    grid_heading = float(np.degrees(np.pi / 2 - np.arctan2(*truth.C_b_G[0][1::-1, 0])))
    top = {
        'imu': {'topic': '/follower/imu/data_raw'},
        'dvl': {'topic': '/follower/dvl/twist'},
        'depth': {'topic': '/follower/depth/pressure', 'sigma': 0.05},
        'fixes': {'topic': '/follower/nav/fix', 'delay_s': 0.5},
        'initial': {
            'from': 'topic',
            'topic': '/follower/nav/fix',
            'grid_heading_deg': grid_heading,
            'rest_s': 2.0,
        },
        'truth': {'topic': '/follower/truth'},
    }
    run = replay(open_source(REFERENCE), mapping_file.from_section(Section('m', top)))
    first = run.estimates.rows(slice(0, 1))
    k = int(np.searchsorted(truth.stamp_ns, first.stamp_ns[0]))
    assert np.linalg.norm(first.r_e[0] - truth.r_e[k]) < 10.0  # that of the first estimate
    assert np.abs(first.v_G[0] - truth.v_G[k]).max() < 0.05
    assert np.abs(first.C_b_G[0] - truth.C_b_G[k]).max() < np.radians(1.0)
    assert run.verdicts['FUSED'] >= 25
    assert 'roll and pitch from gravity; heading as stated; velocity from the DVL' in (
        run.loaded.start.how
    )
