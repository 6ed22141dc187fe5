"""Commands that measure wait for all kernels that are compiled in the background.

A graph waits for those that its nodes load.
"""

import fcntl
import sys

import pytest

from polar_nav_core import background, warm
from polar_nav_tools.cli import bench, development
from polar_nav_tools.graph.build import build_graph
from polar_nav_tools.graph.options import GraphOptions
from polar_nav_tools.live import kernels, run
from polar_nav_tools.live.run import read_mission


class Waits(Exception):
    pass


@pytest.mark.parametrize(
    ('command', 'arguments', 'what'),
    [
        (bench.core, {'processor': 0}, 'measurements wait'),
        (development.run_tests, {'context': None}, 'tests wait'),
    ],
)
def test_command_waits_before_it_begins(command, arguments, what, monkeypatch):
    said = []

    def wait(what):
        said.append(what)
        raise Waits

    monkeypatch.setattr(background, 'wait', wait)
    with pytest.raises(Waits):
        command(**arguments)
    assert said == [what]


def graph_of(mission, **options):
    chosen = GraphOptions(pace='lockstep', seed=1, **options)
    return build_graph(read_mission(mission, 60.0, as_recorded=False), chosen)


def test_no_node_starts_before_its_kernels_are_there(monkeypatch, tmp_path):
    graphs = []

    def wait(graph):
        graphs.append(graph)
        raise Waits

    monkeypatch.setattr(run, 'wait_for_kernels', wait)
    monkeypatch.setattr(run, 'Supervisor', None)
    mission = read_mission('demo', 60.0, as_recorded=False)
    with pytest.raises(Waits):
        run.run_live(mission, GraphOptions(pace='lockstep', seed=1), tmp_path, own_domain=True)
    assert [graph.mission for graph in graphs] == ['demo']


@pytest.mark.parametrize(
    ('mission', 'configuration', 'loaded'),
    [
        ('demo', 'default', 'clone'),
        ('demo', 'modified_akf', 'back_propagate'),
        ('demo', 'conventional_akf', 'ignore'),
        ('station', 'default', 'station'),
    ],
)
def test_kernels_are_those_of_the_follower(mission, configuration, loaded, monkeypatch):
    asked = []
    monkeypatch.setattr(background, 'compiles', lambda: True)
    monkeypatch.setattr(warm, 'warm_node', asked.append)
    monkeypatch.setattr(warm, 'warm_others', lambda: asked.append('station'))
    said = []
    kernels.wait_for_kernels(graph_of(mission, configuration=configuration), said.append)
    assert asked == [loaded]
    assert said == ['the graph waits for the kernels of its nodes']


def test_nothing_is_loaded_or_said_when_all_are_there(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    with (tmp_path / background.LOCK).open('w') as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert background.compiles()
    monkeypatch.setattr(warm, 'warm_engine', None)
    kernels.wait_for_kernels(graph_of('demo'), pytest.fail)
