"""What a recording leaves out or only names keeps the meaning of the engine that recorded it."""

from dataclasses import fields

from polar_nav_core.engine.methods import CONFIGURATIONS, STATION_CONFIGURATIONS
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_follower import defaults
from polar_nav_follower.defaults import defaults_of
from polar_nav_follower.params import FollowerParams

FROZEN_CONFIGURATIONS = {
    1: {
        'conventional_akf': ('ignore', 'adaptive_r', 1.0, 'none'),
        'modified_akf': ('back_propagate', 'adaptive_r', 1.0, 'none'),
        'conventional_akf_published': ('ignore', 'sage_husa_unguarded', 1.0, 'none'),
        'modified_akf_published': ('back_propagate', 'sage_husa_published', 1.0, 'none'),
        'default': ('back_propagate', 'none', 0.9999, 'none'),
        'station augmented': ('rewind', 'none', 0.9999, 'mahalanobis'),
        'station published': ('tagged', 'none', 1.0, 'none'),
    },
    2: {'default': ('clone', 'none', 0.9999, 'mahalanobis')},
}
"""By the engine version since which a name stands for this."""


def test_no_default_changes_and_no_parameter_comes_without_an_entry():
    """Add the value that reproduces engine 1 to `_FIRST`, today's to `_SINCE`, and count up."""
    today = {f.name: f.default for f in fields(FollowerParams)}
    assert defaults_of(ENGINE_VERSION) == today
    types = {name: type(value) for name, value in today.items()}
    assert {n: type(v) for n, v in defaults_of(ENGINE_VERSION).items()} == types


def test_an_older_engine_keeps_its_values(monkeypatch):
    monkeypatch.setattr(defaults, '_SINCE', {3: {'dvl_sigma': 0.5}, 2: {'dvl_sigma': 0.25}})
    found = [defaults_of(version)['dvl_sigma'] for version in (1, 2, 3, 9)]
    assert found == [0.005, 0.25, 0.5, 0.5]


def test_entries_are_of_engines_that_there_are():
    assert all(1 < version <= ENGINE_VERSION for version in defaults._SINCE)
    declared = {f.name for f in fields(FollowerParams)}
    assert all(set(changed) <= declared for changed in defaults._SINCE.values())


def test_a_named_configuration_stands_for_something_else_only_with_another_engine():
    """A recorded run states the name only."""
    named = CONFIGURATIONS | {f'station {k}': c for k, c in STATION_CONFIGURATIONS.items()}
    today = {
        name: (c.delay_handling, c.noise_adaptation, c.gate_probability, c.robust_fixes)
        for name, c in named.items()
    }
    frozen = {}
    for version in sorted(FROZEN_CONFIGURATIONS):
        assert version <= ENGINE_VERSION
        frozen |= FROZEN_CONFIGURATIONS[version]
    assert today == frozen
