"""The example of a leader's parameters: each name is a parameter's, and it fits its follower."""

from pathlib import Path

import yaml

from polar_nav_core.params import from_mapping
from polar_nav_leader.params import LeaderParams

ROOT = Path(__file__).parents[2]


def test_the_leader_of_the_polar_pair_sends_to_its_follower():
    path = ROOT / 'polar_nav_leader' / 'config' / 'polar_pair_leader.yaml'
    content = yaml.safe_load(path.read_text(encoding='utf-8'))
    leader = from_mapping(LeaderParams, content['/**']['ros__parameters'])
    mapping = ROOT / 'polar_nav_follower' / 'config' / 'polar_pair_mapping.yaml'
    (fix,) = yaml.safe_load(mapping.read_text(encoding='utf-8'))['fixes']
    assert (leader.own_id, leader.follower_id) == (fix['leader_id'], fix['own_id'])
    assert leader.navigation == 'own'
