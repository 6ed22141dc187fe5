"""Bags in other people's tools: public readers decode them whole, the Foxglove layout fits."""

import json
import re
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from polar_nav_tools.bags.schemas import definition
from polar_nav_tools.graph.recorded_topics import recorded_topics
from polar_nav_tools.graph.station import station_topics

ROOT = Path(__file__).parents[2]
BAG = next((ROOT / 'bags' / 'reference').glob('*.mcap'))
LAYOUTS = ROOT / 'polar_nav_tools' / 'layouts'
TOPICS = {
    'polar_nav_foxglove': recorded_topics('leader', 'follower'),
    'polar_nav_station_foxglove': station_topics('station', 'auv') | recorded_topics('a', 'b'),
}
PATH = re.compile(r'(?P<topic>/[\w/]+)(?P<fields>(?:\.\w+(?:\[\d+\])?)*)')
STANDARD = {
    'nav_msgs/msg/Odometry',
    'sensor_msgs/msg/NavSatFix',
    'sensor_msgs/msg/Imu',
    'sensor_msgs/msg/FluidPressure',
    'geometry_msgs/msg/TwistWithCovarianceStamped',
    'diagnostic_msgs/msg/DiagnosticArray',
    'rosgraph_msgs/msg/Clock',
}


def test_the_public_reader_decodes_every_message():
    with BAG.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        count = 0
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ('ros2msg', 'cdr')
            header = getattr(decoded, 'header', None)
            if header is not None and channel.topic.startswith('/follower'):
                stamp_ns = header.stamp.sec * 10**9 + header.stamp.nanosec
                assert abs(message.log_time - stamp_ns) < 20e9
            count += 1
    assert count == summary.statistics.message_count > 10_000


def test_every_schema_is_complete():
    """A type that a definition uses is defined in the same text: nothing need be installed."""
    primitive = re.compile(r'^(bool|byte|char|string|wstring|u?int(8|16|32|64)|float(32|64))\b')
    with BAG.open('rb') as stream:
        schemas = make_reader(stream).get_summary().schemas.values()
    for schema in schemas:
        text = schema.data.decode()
        own, *parts = re.split(r'^=+\nMSG: ', text, flags=re.MULTILINE)
        defined = {part.split('\n', 1)[0].strip() for part in parts}
        for body in (own, *(part.split('\n', 1)[1] for part in parts)):
            for line in body.splitlines():
                kind = line.split('#')[0].strip().split(' ')[0].split('[')[0].split('<')[0]
                if not kind or primitive.match(kind):
                    continue
                full = {kind, *(f'{d.rsplit("/", 1)[0]}/{kind}' for d in defined)}
                package = schema.name.split('/')[0]
                full.add(f'{package}/{kind}')
                assert full & defined, f'{schema.name}: {kind} is not defined'


def test_standard_types_are_there_for_tools_that_know_no_others():
    with BAG.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert {s.name for s in summary.schemas.values()} >= STANDARD
    kinds = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    assert kinds['/follower/odometry'] == kinds['/leader/odometry'] == 'nav_msgs/msg/Odometry'
    assert kinds['/follower/nav/fix'] == 'sensor_msgs/msg/NavSatFix'


def layout(name):
    return json.loads((LAYOUTS / f'{name}.json').read_text())


def paths():
    """Every message path and topic that a panel of the layouts shows."""
    found = []
    for of in TOPICS:
        for name, panel in layout(of)['configById'].items():
            found += [(of, name, path['value']) for path in panel.get('paths', ())]
            for key in ('topicPath', 'followTopic', 'topicToRender'):
                if key in panel:
                    found.append((of, name, panel[key]))
    return found


def scripts(of):
    """Source of each script of a layout, by the topic that it writes."""
    sources = [script['sourceCode'] for script in layout(of)['userNodes'].values()]
    return {re.search(r'export const output = "(.+)";', source)[1]: source for source in sources}


def scripts_inputs():
    found = []
    for of in TOPICS:
        for output, source in scripts(of).items():
            inputs = re.search(r'export const inputs = (\[.+\]);', source)[1]
            found += [(of, output, topic) for topic in json.loads(inputs)]
    return found


def definition_of(field, text):
    """Definition of a field in the text of a message, e.g. ``float64[3]``."""
    line = re.search(rf'^(\S+) +{field}\b', text, re.MULTILINE)
    return line and line[1]


@pytest.mark.parametrize(('of', 'panel', 'path'), paths())
def test_panels_show_what_is_recorded(of, panel, path):
    match = PATH.fullmatch(path)
    assert match, path
    assert match['topic'] in TOPICS[of], f'{panel}: no topic {match["topic"]}'
    own, *others = definition(TOPICS[of][match['topic']]).text.split('=' * 80)
    text = own
    for field in match['fields'].split('.')[1:]:
        name, _, index = field.rstrip(']').partition('[')
        kind = definition_of(name, text)
        assert kind, f'{panel}: {path}: no field {name}'
        # A field of a message's own goes on in that message's part of the text.
        text = next((t for t in others if t.startswith(f'\nMSG: {kind}')), '') or next(
            (t for t in others if re.match(rf'\nMSG: \w+/{kind}\n', t)), ''
        )
        size = re.search(r'\[(\d+)\]', kind)
        assert bool(index) == bool(size), path
        assert not index or int(index) < int(size[1]), path


@pytest.mark.parametrize('of', TOPICS)
def test_every_panel_stands_in_the_layout(of):
    def panels(node):
        if isinstance(node, str):
            return {node}
        return panels(node['first']) | panels(node['second'])

    content = layout(of)
    shown = panels(content['layout'])
    for name in list(shown):
        for tab in content['configById'][name].get('tabs', ()):
            shown |= panels(tab['layout'])
    assert shown == set(content['configById'])
    # What docs/trust.md says is in it.
    kinds = {name.split('!')[0] for name in shown}
    assert kinds >= {'Plot', 'StateTransitions', 'DiagnosticSummary', 'map', '3D'}


@pytest.mark.parametrize(('of', 'output', 'topic'), scripts_inputs())
def test_scripts_read_what_is_recorded(of, output, topic):
    source = scripts(of)[output]
    assert f'Input<"{topic}">' in source
    assert f'  "{topic}": {{ label:' in source
    position = {
        'nav_msgs/msg/Odometry': r'message\.pose\.pose\.position',
        'polar_nav_msgs/msg/VehicleTruth': r'message\.r_e\[2\]',
    }
    assert re.search(position[TOPICS[of][topic]], source)


def test_scripts_differ_by_their_topics_alone():
    ours, station = (
        re.sub(r'.*"/(?!studio_script)\w+/.*\n', '', source)
        for of in TOPICS
        for source in scripts(of).values()
    )
    assert ours == station


@pytest.mark.parametrize('of', TOPICS)
def test_the_3d_panel_shows_topics_that_it_can_draw(of):
    """Lichtblick's draws no Odometry, and its display frame must be one of a drawn message."""
    panels = {n: p for n, p in layout(of)['configById'].items() if n.startswith('3D!')}
    assert panels
    for panel in panels.values():
        assert panel['topics'].keys() == scripts(of).keys()
        frames = {panel['followTf'], *(layer['frameId'] for layer in panel['layers'].values())}
        for source in scripts(of).values():
            assert {re.search(r'frame_id: "(.+)"', source)[1]} == frames


@pytest.mark.parametrize('of', TOPICS)
def test_plots_have_their_titles(of):
    """Each program has its own key; a plot without is called Plot."""
    for name, panel in layout(of)['configById'].items():
        assert panel.get('foxglovePanelTitle') == panel.get('lichtblickPanelTitle')
        assert 'title' not in panel, f'{name}: no program reads this'
        if name.startswith(('Plot!', '3D!', 'map!')):
            assert panel['foxglovePanelTitle']


def test_the_layout_is_installed():
    setup = (ROOT / 'polar_nav_tools' / 'setup.cfg').read_text()
    assert 'share/polar_nav_tools/layouts = layouts/*.json' in setup
