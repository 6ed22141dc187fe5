"""Views of RViz and Foxglove: what they name is published, in the type and the keys they know.

Neither program is run. What they know was read in their sources: rviz 14.3 (ros2/rviz f7112b1),
Lichtblick (lichtblick-suite/lichtblick 66adecb), the open program that has Foxglove's layouts.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml

from polar_nav_ros import topics

ROOT = Path(__file__).parents[2]
PREFIX = '/follower/'
SHOWN = (
    topics.ODOMETRY_NOW,
    topics.ODOMETRY_LOCAL,
    topics.ODOMETRY_DEPTH,
    topics.RESET_COUNTER,
    topics.STATE,
    topics.HEALTH,
    topics.FIX,
)
NAMES = {topics.DIAGNOSTICS} | {f'{PREFIX}{name}' for name in SHOWN}
FRAMES = {f'follower/{frame}' for frame in ('map', 'odom', 'base_link')}

TOPIC_KEYS = {'Value', 'Depth', 'Durability Policy', 'History Policy', 'Reliability Policy'}
DISPLAY_KEYS = {'Class', 'Name', 'Enabled'}
RVIZ: dict[str, Any] = {
    'rviz_common/Displays': {'Class', 'Name'},
    'rviz_common/Views': {'Class', 'Name'},
    'rviz_default_plugins/Grid': DISPLAY_KEYS
    | {'Cell Size', 'Plane Cell Count', 'Color', 'Reference Frame'},
    'rviz_default_plugins/TF': DISPLAY_KEYS | {'Marker Scale', 'Show Axes', 'Show Names'},
    'rviz_default_plugins/Odometry': DISPLAY_KEYS
    | {'Keep', 'Position Tolerance', 'Angle Tolerance', 'Topic', 'Shape', 'Covariance'},
    'rviz_default_plugins/MoveCamera': {'Class'},
    'rviz_default_plugins/Measure': {'Class'},
    'rviz_default_plugins/SetInitialPose': {
        'Class',
        'Topic',
        'Covariance x',
        'Covariance y',
        'Covariance yaw',
    },
    'rviz_default_plugins/Orbit': {'Class', 'Distance', 'Pitch', 'Yaw', 'Target Frame'},
}
"""Keys of each class that stands in the file; not all that the class has."""
RVIZ_PARTS = {
    'Topic': TOPIC_KEYS,
    'Shape': {
        'Value', 'Axes Length', 'Axes Radius', 'Color', 'Shaft Length', 'Head Length'
    },
    'Covariance': {'Value', 'Position', 'Orientation'},
    'Position': {'Value', 'Color', 'Alpha'},
    'Orientation': {'Value'},
}  # fmt: skip

TITLES = {'foxglovePanelTitle', 'lichtblickPanelTitle'}
PANELS: dict[str, set[str]] = {
    '3D': TITLES
    | {
        'followMode', 'followTf', 'cameraState', 'topics', 'layers', 'publish', 'scene',
        'transforms', 'imageMode',
    },
    'map': {'topicColors', 'disabledTopics', 'followTopic', 'layer', 'zoomLevel'},
    'Plot': TITLES
    | {
        'paths', 'showXAxisLabels', 'showYAxisLabels', 'showLegend', 'legendDisplay', 'isSynced',
        'xAxisVal', 'followingViewWidth', 'sidebarDimension',
    },
    'DiagnosticSummary': {
        'minLevel', 'pinnedIds', 'hardwareIdFilter', 'topicToRender', 'sortByLevel'
    },
}  # fmt: skip
DRAWN = {'foxglove.SceneUpdate'}
"""Types that the 3D panel draws, of those that are here: an Odometry is none of them."""


def rviz() -> Any:
    path = ROOT / 'polar_nav_follower' / 'config' / 'live.rviz'
    return yaml.safe_load(path.read_text(encoding='utf-8'))


def foxglove() -> Any:
    path = ROOT / 'polar_nav_tools' / 'layouts' / 'polar_nav_live_foxglove.json'
    return json.loads(path.read_text(encoding='utf-8'))


def texts(content: Any) -> Iterator[str]:
    """All keys and values of a tree that are texts."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from (*texts(key), *texts(value))
    elif isinstance(content, list):
        for value in content:
            yield from texts(value)
    elif isinstance(content, str):
        yield content


def named(content: Any) -> tuple[set[str], set[str]]:
    """Topics and frames among the texts of a configuration."""
    found = {t.partition('.')[0] for t in texts(content) if re.match(r'/[a-z]', t)}
    frames = {t for t in texts(content) if t.startswith('follower/')}
    return found, frames


def type_of(topic: str) -> str:
    return topics.TYPES[topic.removeprefix(PREFIX)]


def fields_of(kind: str) -> Mapping[str, str]:
    package, _, name = kind.partition('/')
    message = getattr(import_module(f'{package}.msg'), name.removeprefix('msg/'))
    return message.get_fields_and_field_types()  # type: ignore[no-any-return]


# -- RViz -----------------------------------------------------------------------------------------


def rviz_classes(content: Any) -> Iterator[dict[str, Any]]:
    if isinstance(content, dict):
        if content.get('Class'):
            yield content
        for value in content.values():
            yield from rviz_classes(value)
    elif isinstance(content, list):
        for value in content:
            yield from rviz_classes(value)


def check_parts(content: Any) -> None:
    for key, value in content.items():
        if isinstance(value, dict):
            assert set(value) <= RVIZ_PARTS[key], key
            check_parts(value)


def test_rviz_names_topics_and_frames_of_the_follower():
    found, frames = named(rviz())
    assert f'{PREFIX}{topics.ODOMETRY_NOW}' in found <= NAMES | {f'{PREFIX}initialpose'}
    assert 'follower/map' in frames <= FRAMES


def test_rviz_knows_every_class_and_key():
    manager = rviz()['Visualization Manager']
    assert set(manager) == {'Class', 'Displays', 'Global Options', 'Tools', 'Views'}
    assert set(manager['Global Options']) <= {'Background Color', 'Fixed Frame', 'Frame Rate'}
    assert manager['Global Options']['Fixed Frame'] == 'follower/map'
    classes = list(rviz_classes(rviz()))
    assert len(classes) == 2 + 4 + 3 + 1
    for one in classes:
        assert set(one) <= RVIZ[one['Class']], one['Class']
        check_parts(one)


def test_rviz_draws_the_types_of_its_topics():
    for display in rviz()['Visualization Manager']['Displays']:
        if display['Class'] == 'rviz_default_plugins/Odometry':
            assert type_of(display['Topic']['Value']) == 'nav_msgs/msg/Odometry'
            assert display['Shape']['Value'] in ('Arrow', 'Axes')
            assert display['Topic']['Reliability Policy'] == 'Reliable'
            assert display['Topic']['Durability Policy'] == 'Volatile'


# -- Foxglove -------------------------------------------------------------------------------------


def test_foxglove_names_topics_and_frames_of_the_follower():
    layout = foxglove()
    found, frames = named(layout['configById'])
    scripts = {t for t in found if t.startswith('/studio_script/')}
    for source in (s['sourceCode'] for s in layout['userNodes'].values()):
        found |= set(re.findall(rf'"({PREFIX}[a-z_/]+)"', source))
        assert f'export const output = "{scripts.pop()}";' in source
    assert not scripts
    assert f'{PREFIX}{topics.ODOMETRY_NOW}' in found
    assert {t for t in found if not t.startswith('/studio_script/')} <= NAMES
    assert 'follower/map' in frames <= FRAMES
    assert {t for t in texts(layout['layout']) if '!' in t} == set(layout['configById'])


def test_foxglove_knows_every_panel_and_key():
    assert set(foxglove()) == {
        'configById', 'globalVariables', 'userNodes', 'playbackConfig', 'layout'
    }  # fmt: skip
    for name, panel in foxglove()['configById'].items():
        assert set(panel) <= PANELS[name.partition('!')[0]], name


def plotted() -> list[tuple[str, dict[str, Any]]]:
    panels = foxglove()['configById'].items()
    return [(name, path) for name, panel in panels for path in panel.get('paths', ())]


@pytest.mark.parametrize(('panel', 'path'), plotted(), ids=lambda v: str(v)[:60])
def test_every_plot_is_of_a_number_and_by_a_stamp_that_there_is(panel, path):
    topic, *names = path['value'].split('.')
    fields = fields_of(type_of(topic))
    if path['timestampMethod'] == 'headerStamp':
        assert fields['header'] == 'std_msgs/Header', f'{panel}: {topic} has no header'
    for name in names[:-1]:
        fields = fields_of(fields[name])
    assert fields[names[-1]] in ('double', 'uint32'), path['value']


def test_the_3d_panel_is_given_what_it_draws():
    layout = foxglove()
    (panel,) = [p for n, p in layout['configById'].items() if n.startswith('3D!')]
    made = {}
    for script in layout['userNodes'].values():
        source = script['sourceCode']
        output = re.search(r'export const output = "(.+)";', source)[1]
        made[output] = 'foxglove.' + re.search(r'script\(event: Event\): (\w+)', source)[1]
        for topic in json.loads(re.search(r'export const inputs = (\[.+\]);', source)[1]):
            assert type_of(topic) == 'nav_msgs/msg/Odometry'
            assert f'Input<"{topic}">' in source
            assert f'  "{topic}": {{ r:' in source
    assert {topic: made.get(topic) for topic in panel['topics']} == made
    assert set(made.values()) <= DRAWN
    assert panel['followTf'] in FRAMES
    assert {layer['frameId'] for layer in panel['layers'].values()} <= FRAMES


def test_map_and_diagnostics_have_their_types():
    panels = foxglove()['configById']
    assert type_of(panels['map!live']['followTopic']) == 'sensor_msgs/msg/NavSatFix'
    summary = panels['DiagnosticSummary!nodes']['topicToRender']
    assert topics.TYPES[summary] == 'diagnostic_msgs/msg/DiagnosticArray'
