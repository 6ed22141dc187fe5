"""The processor's name tells models apart, on whatever processor; equal bits are asked of one."""

import platform

import pytest

from polar_nav_tools.live import run_info

X86 = """
processor\t: 0
vendor_id\t: AuthenticAMD
cpu family\t: 25
model\t\t: 17
model name\t: AMD EPYC
stepping\t: 1
"""
ARM = """
processor\t: 0
Features\t: fp asimd evtstrm crc32 cpuid
CPU implementer\t: 0x41
CPU architecture: 8
CPU variant\t: 0x0
CPU part\t: 0xd08
CPU revision\t: 3
"""
BOARD = '\nRevision\t: c03114\nModel\t\t: Raspberry Pi 4 Model B Rev 1.4\n'


@pytest.fixture
def names(monkeypatch, tmp_path):
    """Model and identity that a machine with this text in /proc/cpuinfo gives its processor."""

    def named(machine, text):
        path = tmp_path / 'cpuinfo'
        path.write_text(text)
        monkeypatch.setattr(run_info, '_CPUINFO', path)
        monkeypatch.setattr(platform, 'machine', lambda: machine)
        return run_info.cpu_model(), run_info.cpu_identity()

    return named


def test_x86_by_its_name(names):
    identity = 'AMD EPYC (cpu family 25, model 17, stepping 1)'
    assert names('x86_64', X86 * 2) == ('AMD EPYC', identity)


def test_arm_by_its_numbers(names):
    model, identity = names('aarch64', ARM * 4 + BOARD)
    assert model == 'aarch64 CPU implementer 0x41, CPU part 0xd08'
    assert identity == f'{model} (CPU variant 0x0, CPU revision 3)'


def test_another_part_or_revision_is_another_processor(names):
    texts = [ARM, ARM.replace('0xd08', '0xd0b'), ARM.replace('revision\t: 3', 'revision\t: 1')]
    assert len({names('aarch64', text)[1] for text in texts}) == 3


def test_cores_of_two_kinds_are_both_named(names):
    model, _ = names('aarch64', ARM.replace('0xd08', '0xd03') * 4 + ARM * 2)
    assert model == 'aarch64 CPU implementer 0x41, CPU part 0xd03 and 0xd08'


def test_an_emulator_that_shows_its_hosts_processor_is_not_that_processor(names):
    assert names('aarch64', X86)[0] == 'aarch64 AMD EPYC'


def test_without_a_description_the_architecture_is_its_name(names):
    assert names('riscv64', 'hart\t: 0\n') == ('riscv64', 'riscv64')
