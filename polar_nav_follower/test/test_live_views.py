"""Configurations of RViz and Foxglove name topics and frames that a follower publishes."""

import json
import re
from pathlib import Path

import yaml

from polar_nav_ros import topics

ROOT = Path(__file__).parents[2]
NAMES = {topics.DIAGNOSTICS} | {
    f'/follower/{name}'
    for name in (
        topics.ODOMETRY_NOW,
        topics.ODOMETRY_LOCAL,
        topics.ODOMETRY_DEPTH,
        topics.RESET_COUNTER,
        topics.STATE,
        topics.HEALTH,
        topics.FIX,
    )
}
FRAMES = {f'follower/{frame}' for frame in ('map', 'odom', 'base_link')}


def texts(content):
    """All keys and values of a tree that are texts."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from (*texts(key), *texts(value))
    elif isinstance(content, list):
        for value in content:
            yield from texts(value)
    elif isinstance(content, str):
        yield content


def named(content):
    """Topics and frames among the texts of a configuration."""
    found = {t.partition('.')[0] for t in texts(content) if re.match(r'/[a-z]', t)}
    frames = {t for t in texts(content) if t.startswith('follower/')}
    return found, frames


def test_rviz():
    path = ROOT / 'polar_nav_follower' / 'config' / 'live.rviz'
    found, frames = named(yaml.safe_load(path.read_text(encoding='utf-8')))
    assert '/follower/odometry/now' in found <= NAMES
    assert 'follower/map' in frames <= FRAMES


def test_foxglove():
    path = ROOT / 'polar_nav_tools' / 'layouts' / 'polar_nav_live_foxglove.json'
    layout = json.loads(path.read_text(encoding='utf-8'))
    found, frames = named(layout['configById'])
    assert '/follower/odometry/now' in found <= NAMES
    assert 'follower/map' in frames <= FRAMES
    assert {t for t in texts(layout['layout']) if '!' in t} == set(layout['configById'])
