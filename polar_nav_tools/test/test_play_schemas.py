"""Message packages of a bag's definitions: what is built, what is refused, what is written."""

import re
import shutil
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polar_nav_tools.bags.decode import store_of
from polar_nav_tools.bags.errors import BagError
from polar_nav_tools.play import generate
from polar_nav_tools.play.schemas import MOST_PACKAGES, Recipe, message_text, plan

RULE = '=' * 80
HEADER = f'{RULE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n'
TIME = f'{RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n'
PING = (
    '# a comment\nuint8 GOOD=1 # and one\nfloat32 LIMIT=0.5\nstring WORD=hello\n'
    'std_msgs/Header header\nfloat64[3] velocity\nacme_base/Beam[<=4] beams\nstring<=10 form\n'
    f'int16[] counts\nbool ok true\n{RULE}\nMSG: acme_base/Beam\nfloat32 range\n{HEADER}{TIME}'
)
PING_FILE = (
    'uint8 GOOD=1\nfloat32 LIMIT=0.5\nstd_msgs/Header header\nfloat64[3] velocity\n'
    'acme_base/Beam[<=4] beams\nstring<=10 form\nint16[] counts\nbool ok\n'
)
HERE = {'std_msgs', 'builtin_interfaces', 'geometry_msgs', 'numpy'}


def planned(**texts):
    by_type = {name.replace('__', '/'): text for name, text in texts.items()}
    return plan(by_type, HERE.__contains__)


def reason(text, name='acme_msgs/msg/Ping'):
    found = plan({name: text}, HERE.__contains__)
    assert found.recipes == []
    return found.refused[name]


def test_a_package_is_built_after_those_that_it_needs():
    found = planned(acme_msgs__msg__Ping=PING)
    assert [r.package for r in found.recipes] == ['acme_base', 'acme_msgs']
    assert found.recipes[1].files == {'Ping': PING_FILE}
    assert found.recipes[1].needs == {'acme_base', 'std_msgs'}
    assert found.used == {'acme_msgs/msg/Ping': {'acme_base', 'acme_msgs'}}


def test_an_installed_type_needs_nothing():
    text = f'builtin_interfaces/Time stamp\nstring frame_id\n{TIME}'
    found = planned(std_msgs__msg__Header=text)
    assert found.recipes == []
    assert found.used == {'std_msgs/msg/Header': set()}


@pytest.mark.parametrize(
    ('text', 'word'),
    [
        (f'acme_msgs/Ping p\n{RULE}\nMSG: acme_msgs/Ping\nacme_msgs/Ping p\n', 'itself'),
        ('float64[10000000] x\n', 'bytes'),
        ('\n'.join(f'bool x{k}' for k in range(300)), 'more than'),
        (f'numpy/Thing x\n{RULE}\nMSG: numpy/Thing\nbool x\n', 'numpy is installed'),
        (f'std_msgs/Header h\n{RULE}\nMSG: std_msgs/Header\nbool x\n', 'other fields'),
        ('', 'no definition'),
        ('bool x\nbool x\n', 'not understood'),
        ('bool X\n', 'not allowed'),
        ('bool a__b\n', 'not allowed'),
        ('wstring x\n', 'wstring'),
    ],
)
def test_definitions_that_are_refused(text, word):
    assert word in reason(text)


@pytest.mark.parametrize(
    'name', ['acme_msgs/srv/Ping', 'acme_msgs/msg/ping', 'Acme/msg/Ping', 'a__b/msg/Ping', 'x']
)
def test_names_that_are_refused(name):
    assert reason('bool x\n', name)


def test_arrays_of_arrays_of_messages_are_counted():
    layers = ''.join(
        f'{RULE}\nMSG: acme_msgs/L{k}\nacme_msgs/L{k + 1}[100] x\n' for k in range(1, 4)
    )
    text = f'acme_msgs/L1[100] x\n{layers}{RULE}\nMSG: acme_msgs/L4\nfloat64 x\n'
    assert 'bytes' in reason(text)


def test_one_type_in_two_ways_is_refused_and_the_rest_is_kept():
    first = f'acme_base/Beam b\n{RULE}\nMSG: acme_base/Beam\nfloat32 range\n'
    found = planned(acme_msgs__msg__A=first, acme_msgs__msg__B=first.replace('range', 'distance'))
    assert 'two ways' in found.refused['acme_msgs/msg/B']
    assert list(found.used) == ['acme_msgs/msg/A']
    assert found.recipes[1].files == {'A': 'acme_base/Beam b\n'}


def test_packages_that_need_one_another_are_refused():
    text = f'b_msgs/B b\n{RULE}\nMSG: b_msgs/B\na_msgs/C c\n{RULE}\nMSG: a_msgs/C\nbool x\n'
    assert 'one another' in reason(text, 'a_msgs/msg/A')


def test_the_number_of_packages_is_limited():
    texts = {f'acme_{k}/msg/A': 'bool x\n' for k in range(MOST_PACKAGES + 3)}
    found = plan(texts, HERE.__contains__)
    assert len(found.recipes) == MOST_PACKAGES
    assert len(found.refused) == 3


LINE = re.compile(
    r'[a-z][a-z0-9_]*(?:/[A-Z][A-Za-z0-9]*)?(?:<=\d+)?(?:\[(?:<=)?\d*\])? '
    r'(?:[a-z][a-z0-9_]*|[A-Z][A-Z0-9_]*=[-+.0-9a-z]+)'
)


@given(
    st.lists(
        st.text(st.sampled_from('abzAZ_01 =#"\'\\/[]<>.;$(){}\t\n'), max_size=30)
        | st.from_regex(LINE, fullmatch=True),
        max_size=6,
    )
)
def test_only_names_and_numbers_get_into_a_file(lines):
    """No text of a bag reaches CMake, the generators or a compiler in another form."""
    try:
        store = store_of('\n'.join(lines), 'acme_msgs/msg/A')
        text = message_text(store, 'acme_msgs/msg/A')
    except BagError:
        return
    assert all(LINE.fullmatch(line) for line in text.splitlines())


def test_the_key_is_of_all_definitions():
    recipe = Recipe('acme_msgs', {'A': 'bool x\n'}, {'acme_base'})
    key = generate.key_of(recipe, {'acme_base': '1'})
    assert key == generate.key_of(recipe, {'acme_base': '1'})
    assert key != generate.key_of(recipe, {'acme_base': '2'})
    assert key != generate.key_of(
        Recipe('acme_msgs', {'A': 'bool y\n'}, {'acme_base'}), {'acme_base': '1'}
    )


def test_without_a_compiler_a_sentence_names_package_and_option(monkeypatch, tmp_path):
    monkeypatch.setenv('CXX', 'no-such-compiler')
    recipes = [Recipe('acme_base', {'A': 'bool x\n'}), Recipe('acme_msgs', {}, {'acme_base'})]
    prefixes, failed = generate.provide(recipes, tmp_path, pytest.fail)
    assert prefixes == {}
    assert set(failed) == {'acme_base', 'acme_msgs'}
    for word in ('acme_base', 'C++ compiler', '--no-build'):
        assert word in failed['acme_msgs']


def test_a_package_that_is_here_is_never_built():
    assert generate.has_package('std_msgs')
    assert generate.has_package('json')  # no messages, but importing it must not change
    assert not generate.has_package('acme_msgs')
    assert not generate.has_package('acme.msgs')


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_built_package_is_published_like_any_other_and_built_once(tmp_path):
    pytest.importorskip('rosidl_generator_py')
    if shutil.which('c++') is None:
        pytest.skip('needs a compiler')
    recipe = Recipe('acme_odd_msgs', {'Ping': 'uint8 GOOD=1\nfloat64 x\n'})
    said = []
    prefixes, failed = generate.provide([recipe], tmp_path, said.append)
    assert failed == {}
    assert len(said) == 1
    again, _ = generate.provide([recipe], tmp_path, pytest.fail)
    assert again == prefixes
    # In a process of its own, which has nothing of the package but what `load` gives it.
    code = (
        'import pathlib, sys\n'
        'from polar_nav_tools.play.generate import load\n'
        'load([pathlib.Path(sys.argv[1])])\n'
        'import rclpy\n'
        'from acme_odd_msgs.msg import Ping\n'
        'rclpy.init()\n'
        "node = rclpy.create_node('n')\n"
        "publisher = node.create_publisher(Ping, '/ping', 1)\n"
        'publisher.publish(bytes([0, 1, 0, 0]) + bytes(8))\n'
        'assert Ping.GOOD == 1\n'
    )
    subprocess.run([sys.executable, '-c', code, str(prefixes['acme_odd_msgs'])], check=True)
