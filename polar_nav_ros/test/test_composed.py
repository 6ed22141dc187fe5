"""Nodes that share a process: names, parameters, ends, and which of them failed. Ring 2."""

import json
import os
import signal
import subprocess
import sys
import textwrap

import pytest

pytest.importorskip('rclpy')

from polar_nav_ros import composed
from polar_nav_ros.node import SUPERVISED

COMMON = """
    from dataclasses import dataclass
    from polar_nav_core.errors import PolarNavError
    from polar_nav_core.params import NodeParams, param
    from polar_nav_ros.node import PolarNode

    @dataclass(frozen=True)
    class Params(NodeParams):
        gain: float = param(2.0, 'm', 0.0, 10.0, 'Factor')
"""
SAYING = """
    from common import *

    class {kind}(PolarNode[Params]):
        def __init__(self):
            super().__init__('{name}', Params)
            print(self.get_fully_qualified_name(), self.params.gain, flush=True)

        def close(self):
            print('{name} closes', flush=True)
"""
FAILING = """
    from common import *

    class Failing(PolarNode[Params]):
        def __init__(self):
            super().__init__('failing_node', Params)
            self.create_timer(0.01, self.fail)

        def fail(self):
            raise {error}

        def close(self):
            print('a node that failed is not closed', flush=True)
"""
ENDING = """
    from common import *

    class Ending(PolarNode[Params]):
        def __init__(self):
            super().__init__('ending_node', Params)
            self.create_timer(0.01, self.leave)

        def leave(self):
            self.ended = 2
"""


@pytest.fixture
def start(tmp_path):
    """Function that starts nodes, made of the texts of their modules, in one process."""
    started = []

    def process(*arguments, **modules):
        for name, text in {'common': COMMON, **modules}.items():
            (tmp_path / f'{name}.py').write_text(textwrap.dedent(text))
        command = 'import sys; from polar_nav_ros.composed import main; sys.exit(main())'
        started.append(
            subprocess.Popen(
                [sys.executable, '-c', command, *modules, '--ros-args', *map(str, arguments)],
                env={
                    **os.environ,
                    'PYTHONPATH': f'{tmp_path}{os.pathsep}{os.environ.get("PYTHONPATH", "")}',
                    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                    'ROS_DOMAIN_ID': str(60 + os.getpid() % 20),
                    SUPERVISED: '1',
                },
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        return started[-1]

    yield process
    for one in started:
        if one.poll() is None:
            one.kill()
        one.communicate()


def saying(name):
    return SAYING.format(kind=name.title(), name=f'{name}_node')


def test_each_has_its_name_and_parameters_and_all_are_closed_in_order(start, tmp_path):
    parameters = tmp_path / 'two.yaml'
    section = {name: {'ros__parameters': {'gain': g}} for name, g in (('a', 3.0), ('b', 4.0))}
    parameters.write_text(
        json.dumps({f'/auv/{name}_node': values for name, values in section.items()})
    )
    given = ('-r', '__ns:=/auv', '--params-file', parameters)
    process = start(*given, a_node=saying('a'), b_node=saying('b'))
    said = []
    while 'ready /auv/b_node' not in said:
        said.append(process.stdout.readline().strip())
        assert process.poll() is None, process.stderr.read()
    assert said[:2] == ['/auv/a_node 3.0', '/auv/b_node 4.0']
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30.0)
    assert process.returncode == 0, err
    last = [line for line in out.splitlines() if not line.startswith('alive')]
    assert last[:2] == ['a_node closes', 'b_node closes']
    assert [line.split()[:2] for line in last[2:]] == [
        ['counts', '/auv/a_node'],
        ['counts', '/auv/b_node'],
    ]


@pytest.mark.slow
@pytest.mark.parametrize('error', ["PolarNavError('the tank is empty')", "KeyError('tank')"])
def test_a_node_that_fails_is_named_and_those_beside_it_are_closed(start, error):
    process = start(
        a_node=saying('a'), failing_node=FAILING.format(error=error), b_node=saying('b')
    )
    out, err = process.communicate(timeout=30.0)
    assert process.returncode == 1
    assert 'tank' in err
    assert 'failed failing_node' in out.splitlines()
    assert 'a_node closes' in out
    assert 'b_node closes' in out
    assert 'is not closed' not in out
    assert ('Traceback' in err) is error.startswith('KeyError')


@pytest.mark.slow
def test_a_node_that_fails_as_it_is_closed_leaves_the_closing_of_others_to_them(start):
    sour = FAILING.replace('raise {error}', 'self.ended = 0').replace(
        "print('a node that failed is not closed', flush=True)", "raise PolarNavError('sour')"
    )
    process = start(failing_node=sour, b_node=saying('b'))
    out, err = process.communicate(timeout=30.0)
    assert process.returncode == 1
    assert err.splitlines() == ['Failing: sour']
    assert 'failed failing_node' in out.splitlines()
    assert 'b_node closes' in out


@pytest.mark.slow
def test_a_parameter_that_is_refused_ends_all_with_the_name_of_its_node(start):
    process = start('-p', 'b_node:gain:=-1.0', a_node=saying('a'), b_node=saying('b'))
    out, err = process.communicate(timeout=30.0)
    assert process.returncode == 2
    assert err.splitlines() == ['B: parameter gain: -1.0 is refused: a float in [0.0, 10.0] m']
    assert 'failed b_node' in out.splitlines()


@pytest.mark.slow
def test_all_end_with_the_one_that_ends_first_and_its_status(start):
    process = start(a_node=saying('a'), ending_node=ENDING)
    out, err = process.communicate(timeout=30.0)
    assert process.returncode == 2, err
    assert 'failed ending_node' in out.splitlines()
    assert 'a_node closes' in out


@pytest.mark.parametrize(
    ('named', 'sentence'),
    [
        ([], 'no node is stated'),
        (['polar_nav_ros.no_node'], 'there is no Python module of this name'),
        (['polar_nav_ros.stamps'], 'node polar_nav_ros.stamps: the module has 0 nodes, not one'),
        (['polar_nav_ros.modem_bridge'] * 2, 'polar_nav_ros.modem_bridge is stated twice'),
    ],
)
def test_what_is_no_node_is_refused_with_one_sentence(named, sentence, capsys):
    assert composed.main(named) == 2
    said = capsys.readouterr().err
    assert said.startswith('composed: ')
    assert sentence in said
    assert said.count('\n') == 1


def test_a_module_that_lacks_what_it_imports_is_not_said_to_be_missing(tmp_path, monkeypatch):
    (tmp_path / 'lacking_node.py').write_text('import polar_nav_absent')
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match='polar_nav_absent'):
        composed.class_of('lacking_node')


def test_it_says_what_it_is(capsys):
    assert composed.main(['--help']) == 0
    assert 'one executor' in capsys.readouterr().out
