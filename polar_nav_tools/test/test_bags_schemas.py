"""Message definitions: complete, with what they depend on, and understood by others."""

import pytest
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from polar_nav_tools.bags.errors import BagError
from polar_nav_tools.bags.schemas import collect, definition, normalize, starts_with_header

ALL = [
    *(
        f'polar_nav_msgs/msg/{n}'
        for n in (
            'AcousticPacket',
            'Command',
            'Depth',
            'Dvl',
            'FixReceipt',
            'InitialState',
            'LeaderBroadcast',
            'LockstepAck',
            'NavState',
            'UsblFix',
            'VehicleTruth',
            'WaterCurrent',
        )
    ),
    'sensor_msgs/msg/Imu',
    'sensor_msgs/msg/FluidPressure',
    'sensor_msgs/msg/NavSatFix',
    'nav_msgs/msg/Odometry',
    'geometry_msgs/msg/TwistWithCovarianceStamped',
    'geometry_msgs/msg/WrenchStamped',
    'diagnostic_msgs/msg/DiagnosticArray',
    'rosgraph_msgs/msg/Clock',
    'std_msgs/msg/String',
    'rcl_interfaces/msg/ParameterEvent',
]


@pytest.mark.parametrize('name', ALL)
def test_definition_is_complete_and_means_what_rosbags_knows(name):
    described = definition(name)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(described.text, name))
    # The hash covers every field of every type it depends on; the package has its own.
    assert store.hash_rihs01(name) == described.type_hash
    assert name in generate_dynamic(name, described.text)


def test_header_is_found_where_it_is_first():
    with_header = {n for n in ALL if definition(n).has_header}
    without = set(ALL) - with_header
    assert without == {
        'polar_nav_msgs/msg/LockstepAck',
        'rosgraph_msgs/msg/Clock',
        'std_msgs/msg/String',
        'rcl_interfaces/msg/ParameterEvent',
    }
    assert not starts_with_header('uint8 a\nstd_msgs/Header header\n')
    # A constant is no field: no message holds it.
    assert starts_with_header('uint8 A=1\nstd_msgs/Header header\n')
    assert not starts_with_header('')


def test_names():
    assert normalize('std_msgs/String') == 'std_msgs/msg/String'
    assert definition('std_msgs/String').type == 'std_msgs/msg/String'
    for wrong in ('String', 'a/srv/B', 'a/b/c/d', '', 'a/msg/', '../msg/x'):
        with pytest.raises(BagError, match='is not a message type; it should be package/msg/Name'):
            normalize(wrong)


def test_a_package_of_ones_own(tmp_path):
    folder = tmp_path / 'share' / 'whales' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Song.msg').write_text(
        '# about a song # with signs\n'
        'Note[<=8] notes  # same package\n'
        'string<=5 name "a # b"\n'
        'other/Thing thing\n'
        'uint8 LOUD=1\n'
    )
    (folder / 'Note.msg').write_text('float64[2] pitch')
    with pytest.raises(BagError, match=r'other/msg/Thing \(needed by whales/msg/Song\): package'):
        collect('whales/msg/Song', [tmp_path])
    other = tmp_path / 'share' / 'other' / 'msg'
    other.mkdir(parents=True)
    (other / 'Thing.msg').write_text('whales/Note again\n')
    described = collect('whales/msg/Song', [tmp_path / 'nowhere', tmp_path])
    assert described.text.count('MSG: ') == 2
    assert described.text.endswith('=' * 80 + '\nMSG: other/Thing\nwhales/Note again\n')
    assert described.type_hash == ''


def test_missing_package():
    with pytest.raises(BagError, match='package whales is not installed in this environment'):
        definition('whales/msg/Song')
