"""ROS domain and environment of a graph."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from polar_nav_tools.live.domain import (
    LAST_DOMAIN_ID,
    free_domain_id,
    graph_environment,
    last_port,
)
from polar_nav_tools.live.middleware import profile


def test_two_processes_start_in_different_domains():
    assert free_domain_id(1000, ()) != free_domain_id(1001, ())


@pytest.mark.parametrize('pid', [0, 1, 100, 101, 4194304])
def test_domain_is_in_the_safe_range(pid):
    assert 1 <= free_domain_id(pid, ()) <= LAST_DOMAIN_ID


def test_a_domain_with_any_socket_in_its_port_range_is_passed_over():
    start = free_domain_id(7, ())
    ports = [7400 + 250 * start, 7400 + 250 * (start + 1) + 249]
    assert free_domain_id(7, ports) == start + 2
    assert free_domain_id(7, [last_port(start)]) == start + 1
    assert free_domain_id(7, [last_port(start - 1)]) == start


def test_search_wraps_around_and_gives_up_gracefully():
    last = LAST_DOMAIN_ID - 1  # the pid whose search starts at the last domain
    assert free_domain_id(last, ()) == LAST_DOMAIN_ID
    assert free_domain_id(last, [7400 + 250 * LAST_DOMAIN_ID]) == 1
    everything = [7400 + 250 * d for d in range(1, LAST_DOMAIN_ID + 1)]
    assert free_domain_id(7, everything) == 8


def test_what_the_user_set_stays(tmp_path):
    base = {
        'ROS_DOMAIN_ID': '33',
        'ROS_LOG_DIR': '/logs',
        'OMP_NUM_THREADS': '4',
        'HOME': '/h',
        'FASTRTPS_DEFAULT_PROFILES_FILE': 'mine.xml',
    }
    env = graph_environment(tmp_path, base)
    assert {name: env[name] for name in base} == base
    assert env['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'  # its profile may not know


@pytest.mark.parametrize('own_domain', [True, False])
@pytest.mark.parametrize('domain', ['', '33'])
@pytest.mark.parametrize('asked', ['', 'SUBNET'])
def test_this_host_only_unless_a_network_is_asked_for(tmp_path, own_domain, domain, asked):
    base = {'ROS_DOMAIN_ID': domain, 'ROS_AUTOMATIC_DISCOVERY_RANGE': asked}
    env = graph_environment(tmp_path, base, own_domain=own_domain)
    assert env['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'SYSTEM_DEFAULT'
    assert not env['ROS_STATIC_PEERS']
    written = Path(env['FASTRTPS_DEFAULT_PROFILES_FILE']).read_text()
    assert written == profile(network=False)
    assert '<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>' in written

    env = graph_environment(tmp_path, base, own_domain=own_domain, network=True)
    assert env['ROS_AUTOMATIC_DISCOVERY_RANGE'] == asked
    assert 'ROS_STATIC_PEERS' not in env
    written = Path(env['FASTRTPS_DEFAULT_PROFILES_FILE']).read_text()
    assert '127.0.0.1' not in written


def test_without_a_domain_it_takes_its_own_on_this_host_only(tmp_path):
    env = graph_environment(tmp_path, {})
    assert 1 <= int(env['ROS_DOMAIN_ID']) <= LAST_DOMAIN_ID
    assert env['ROS_LOG_DIR'] == str(tmp_path / 'logs' / 'ros')
    assert env['OPENBLAS_NUM_THREADS'] == '1'


def test_the_middleware_profile_is_a_file_that_stays(tmp_path):
    path = Path(graph_environment(tmp_path, {})['FASTRTPS_DEFAULT_PROFILES_FILE'])
    assert path.parent == tmp_path
    root = ElementTree.fromstring(path.read_text())
    assert root.tag.endswith('profiles')


def test_a_graph_that_others_look_at_stays_in_the_domain_of_the_shell(tmp_path):
    assert 'ROS_DOMAIN_ID' not in graph_environment(tmp_path, {}, own_domain=False)
