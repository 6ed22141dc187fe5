"""Types that a bag does not describe, and bags of other kinds, for every command."""

from __future__ import annotations

import json
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from foreign_samples import (
    DVL,
    IMU,
    INERTIAL,
    MAPPING,
    TRIPLE,
    Message,
    engine_parameters,
    restamped,
    write,
)

from polar_nav_core.errors import PolarNavError
from polar_nav_tools.bags.errors import BagError
from polar_nav_tools.bags.finding import Severity
from polar_nav_tools.cli import main
from polar_nav_tools.doctor.examine import examine
from polar_nav_tools.foreign.definitions import undecodable
from polar_nav_tools.foreign.guess import guess
from polar_nav_tools.foreign.info import source_info
from polar_nav_tools.foreign.sources import not_described, open_source

Polar = Callable[..., tuple[int, str, str]]
KIND = 'acme_msgs/msg/Inertial'


@pytest.fixture
def polar(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Polar:
    """Run the tool; exit status, stdout and stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, 'argv', ['polar', *map(str, arguments)])
        status = main()
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


@pytest.fixture(scope='module')
def old(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An sqlite3 bag as old recorders wrote them, without definitions."""
    path = write(tmp_path_factory.mktemp('old') / 'old', 'sqlite3')
    with sqlite3.connect(path / 'old.db3') as base:
        base.execute('delete from message_definitions')
    base.close()
    return path


@pytest.fixture(scope='module')
def messages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with the .msg files of the package that exists nowhere."""
    folder = tmp_path_factory.mktemp('ws')
    package = folder / 'src' / 'acme_msgs' / 'msg'
    package.mkdir(parents=True)
    (package / 'Inertial.msg').write_text(INERTIAL)
    (package / 'Triple.msg').write_text(TRIPLE)
    return folder


def test_types_without_a_definition_are_named(old: Path, messages: Path) -> None:
    """With their number; the .msg files of their package mend it."""
    source = open_source(old)
    assert not_described(source) == (KIND,)
    says = (
        '1 type cannot be decoded because the bag carries no definitions: acme_msgs/msg/Inertial'
    )
    assert says in guess(source)
    assert '`--msg-path DIR`' in guess(source)
    assert not_described(open_source(old, msg_path=messages)) == ()
    many = undecodable([f'a/msg/T{k:02d}' for k in range(26)])
    assert many is not None
    assert many.startswith('26 types cannot be decoded because the bag carries no definitions: ')
    assert 'a/msg/T05 and 20 more' in many
    with pytest.raises(BagError, match=r'holds no \.msg file'):
        open_source(old, msg_path=old)


@pytest.mark.slow
def test_msg_path_of_every_command(
    polar: Polar, old: Path, messages: Path, tmp_path: Path
) -> None:
    """map, replay, doctor and info; without it they say what is missing."""
    mapping = tmp_path / 'm.yaml'
    mapping.write_text(
        yaml.safe_dump(yaml.safe_load(MAPPING) | {'parameters': engine_parameters()})
    )
    status, _, err = polar('replay', old, '--map', mapping)
    assert status == 1
    assert 'does not describe acme_msgs/msg/Inertial' in err
    status, out, _ = polar('replay', old, '--map', mapping, '--msg-path', messages, '--json')
    assert status == 0
    assert json.loads(out)['verdicts'] == {'FUSED': 13}
    status, _, err = polar('replay', old, '--msg-path', messages)
    assert status == 2
    for command in ('map', 'info', 'doctor'):
        status, out, err = polar(command, old)
        assert (status, '1 type cannot be decoded' in out + err) == (0, True), command
        status, out, err = polar(command, old, '--msg-path', messages)
        assert (status, 'cannot be decoded' in out + err) == (0, False), command


@pytest.mark.parametrize('kind', ['mcap', 'sqlite3', 'ros1'])
def test_the_doctor_and_info_read_every_kind(tmp_path: Path, kind: str) -> None:
    """The same findings whatever the file: here a DVL whose stamps run at 29 % of real time."""

    def slow(message: Message) -> Message:
        topic, _, log_ns, _ = message
        behind = round(0.71 * (log_ns - 1772323200 * 10**9))
        return restamped(message, log_ns - behind) if topic == DVL else message

    suffix = '.bag' if kind == 'ros1' else ''
    source = open_source(write(tmp_path / f'bag{suffix}', kind, slow))
    found = examine(source)
    (drift,) = (f for f in found.findings if f.severity is Severity.SEVERE)
    assert (drift.name, drift.topic) == ('drift', DVL)
    assert drift.value == pytest.approx(-0.71, abs=0.01)
    assert 'at 29 % of real time' in drift.text
    rates = {t.topic: t.to_dict()['rate_hz'] for t in found.topics}
    assert rates[IMU] == pytest.approx(100.0)
    assert len(found.topics) == 5
    if kind != 'mcap':
        facts = source_info(source)
        assert {t.name: t.count for t in facts.topics} == {t.topic: t.count for t in found.topics}
        assert next(t for t in facts.topics if t.name == IMU).rate_hz == pytest.approx(100.0)
        assert facts.duration_s == pytest.approx(30.0, abs=0.1)


@pytest.mark.parametrize('kind', ['sqlite3', 'ros1'])
def test_a_damaged_bag_has_a_sentence(tmp_path: Path, kind: str) -> None:
    """Whatever is cut off: an error of this project, or findings."""
    whole = write(tmp_path / ('bag.bag' if kind == 'ros1' else 'bag'), kind)
    file = whole if kind == 'ros1' else next(whole.glob('*.db3'))
    data = file.read_bytes()
    for share in (3, 2):
        file.write_bytes(data[: len(data) * (share - 1) // share])
        with pytest.raises(PolarNavError, match='damaged'):
            examine(open_source(whole))
