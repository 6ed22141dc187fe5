"""The graph keeps to this host: sockets and counters in a namespace with a second interface.

The namespace has the loopback interface and one end of a veth pair with an address and the default
route, as a computer on a network has; nothing of this machine's own interfaces is touched.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = [pytest.mark.live, pytest.mark.paced, pytest.mark.slow]

_IFACE = """
set -e
ip link set lo up
ip link add v0 type veth peer name v1
ip addr add 10.9.8.7/24 dev v0
ip link set v0 up multicast on
ip link set v1 up
ip route add default dev v0
"""


def _unshared(*command: str, **options) -> subprocess.CompletedProcess:
    inside = ['unshare', '--net', '--map-root-user', 'bash', '-c', _IFACE + 'exec "$@"', 'x']
    return subprocess.run([*inside, *command], capture_output=True, text=True, **options)


def _foreign_sockets() -> set[str]:
    """Addresses of UDP sockets in this namespace, other than the loopback's."""
    found = set()
    for name in ('/proc/net/udp', '/proc/net/udp6'):
        for line in Path(name).read_text().splitlines()[1:]:
            address = line.split()[1].rsplit(':', 1)[0]
            if address != '0100007F':  # 127.0.0.1, little end first
                found.add(address)
    return found


def _counters() -> tuple[int, int]:
    """Bytes and packets sent by every interface but the loopback."""
    total = [0, 0]
    for line in Path('/proc/net/dev').read_text().splitlines()[2:]:
        name, numbers = line.split(':')
        if name.strip() == 'v0':
            total = [int(n) for n in numbers.split()[8:10]]
    return total[0], total[1]


def observe(arguments: list[str]) -> dict[str, object]:
    """Run the tool in this namespace and watch its sockets while it runs."""
    quiet = _counters()
    command = [sys.executable, '-P', '-m', 'polar_nav_tools.cli', *arguments]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    seen: set[str] = set()
    most = 0
    while process.poll() is None:
        seen |= _foreign_sockets()
        most = max(most, len(Path('/proc/net/udp').read_text().splitlines()) - 1)
        time.sleep(0.2)
    said = process.stderr.read().decode() if process.stderr else ''
    sent = [b - a for a, b in zip(quiet, _counters(), strict=True)]
    return {
        'status': process.returncode,
        'foreign': sorted(seen),
        'sent': sent,
        'most': most,
        'said': said[-2000:],
    }


@pytest.mark.parametrize('command', ['demo', 'launch'])
def test_no_socket_outside_and_no_byte_sent(command: str, tmp_path: Path) -> None:
    tried = _unshared('true', timeout=20.0, check=False)
    if tried.returncode != 0:
        pytest.skip(f'no network namespace here: {tried.stderr.strip()}')
    env = {k: v for k, v in os.environ.items() if not k.startswith(('ROS_AUTO', 'FASTRTPS'))}
    env |= {'ROS_DOMAIN_ID': '33'}
    arguments = [command, '--duration', '8', '--bag', str(tmp_path / 'bag')]
    done = _unshared(
        sys.executable, __file__, *arguments, env=env, cwd=tmp_path, timeout=240.0, check=False
    )
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    assert seen['status'] == 0, seen['said']
    assert seen['most'] >= 26  # thirteen nodes were there, each with two sockets and more
    assert seen['foreign'] == []
    # What the kernel itself sends when an interface comes up (IPv6 neighbours) is no UDP of ours.
    assert seen['sent'][0] < 1000


if __name__ == '__main__':
    json.dump(observe(sys.argv[1:]), sys.stdout)
