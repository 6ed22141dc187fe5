"""Environment of a graph: an unused ROS domain, this host only, one thread per node."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from pathlib import Path

from .middleware import middleware_environment

LAST_DOMAIN_ID = 101
"""Above it, the ports of a domain reach into Linux' ephemeral range."""

_PORT_BASE, _PORTS_PER_DOMAIN = 7400, 250
_SOCKET_TABLES = ('/proc/net/udp', '/proc/net/udp6')


def busy_udp_ports() -> frozenset[int]:
    """UDP ports bound on this host; empty if the kernel does not list them."""
    ports: set[int] = set()
    for table in map(Path, _SOCKET_TABLES):
        if not table.exists():
            continue
        for line in table.read_text(encoding='ascii').splitlines()[1:]:
            ports.add(int(line.split()[1].rsplit(':', 1)[1], 16))
    return frozenset(ports)


def last_port(domain: int) -> int:
    """Last UDP port of a ROS domain: nodes take the first ones, so whoever binds it holds all."""
    return _PORT_BASE + _PORTS_PER_DOMAIN * (domain + 1) - 1


def free_domain_id(pid: int, busy_ports: Collection[int]) -> int:
    """First ROS domain from ``1 + pid % 101`` on that no socket on this host uses.

    RTPS gives domain d the ports from 7400 + 250 d on.

    Parameters
    ----------
    pid : int
        Where the search starts, so that two runs started at the same moment differ.
    busy_ports : collection of int
        UDP ports in use on this host.

    Returns
    -------
    int
        Domain id in 1..101; the start of the search when all are busy.
    """
    taken = {(port - _PORT_BASE) // _PORTS_PER_DOMAIN for port in busy_ports if port >= _PORT_BASE}
    start = pid % LAST_DOMAIN_ID
    for step in range(LAST_DOMAIN_ID):
        domain = 1 + (start + step) % LAST_DOMAIN_ID
        if domain not in taken:
            return domain
    return 1 + start


def graph_environment(
    run_dir: Path,
    base: Mapping[str, str] | None = None,
    *,
    own_domain: bool = True,
    network: bool = False,
) -> dict[str, str]:
    """Environment variables for the nodes of one graph.

    What the user has set stays as it is: ROS_DOMAIN_ID, thread counts, ROS_LOG_DIR,
    FASTRTPS_DEFAULT_PROFILES_FILE; with a network, ROS_AUTOMATIC_DISCOVERY_RANGE, too.

    Parameters
    ----------
    run_dir : Path
        Gets the middleware's profile, and rclpy's own log files in ``logs/ros``.
    base : mapping, optional
        Environment to start from; by default this process's.
    own_domain : bool
        Choose a domain that nobody uses when the user has not set one. Off for `polar launch`,
        whose graph is there to be seen by others.
    network : bool
        Whether the graph may be seen from other hosts.
    """
    env = dict(os.environ if base is None else base)
    if own_domain and not env.get('ROS_DOMAIN_ID'):
        env['ROS_DOMAIN_ID'] = str(free_domain_id(os.getpid(), busy_udp_ports()))
    env |= node_surroundings(run_dir, env, network=network)
    env.setdefault('ROS_LOG_DIR', str((run_dir / 'logs' / 'ros').absolute()))
    env['POLAR_NAV_SUPERVISED'] = '1'  # nodes print counts and progress (polar_nav_ros.node)
    env['PYTHONUNBUFFERED'] = '1'  # the last lines of a node that is killed must be out already
    env['RCUTILS_COLORIZED_OUTPUT'] = '0'
    return env


def node_surroundings(
    run_dir: Path, env: Mapping[str, str], *, network: bool = False
) -> dict[str, str]:
    """Variables that nodes need and ``env`` lacks: middleware and its network, thread counts.

    Parameters
    ----------
    run_dir : Path
        Gets the middleware's profile.
    env : mapping
        What is set already.
    network : bool
        Whether the graph may be seen from other hosts.
    """
    added = middleware_environment(run_dir, env, network=network)
    # A dozen processes with a thread pool each would fight for the cores; no node multiplies
    # matrices worth sharing.
    names = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'NUMBA_NUM_THREADS')
    return added | {name: '1' for name in names if name not in env}
