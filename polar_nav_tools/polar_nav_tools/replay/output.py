"""Output of a replay as a bag or a summary; changes of parameters by the user."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from polar_nav_core.engine.health.span import span_of_health
from polar_nav_core.engine.version import ENGINE_VERSION
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import to_mapping, unknown_parameter
from polar_nav_core.user_files import parse_yaml
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.topics import CURRENT, HEALTH, IDENTIFICATION, MODEL, RECEIPT, STATE, of_vehicle

from ..bags import Bag, BagWriter
from .by_message import ReplayResult
from .described import Description
from .result import ReplayedRun

_TOPICS = (STATE, RECEIPT, HEALTH)
_MODEL_TOPICS = (CURRENT, MODEL, IDENTIFICATION)


def parse_changes(texts: Sequence[str]) -> dict[str, Any]:
    """Parameters of follower_node from ``name=value`` texts, with values in YAML.

    Raises
    ------
    ConfigError
        For a text without ``=``, and for an unknown name.
    """
    kinds = {f.name: f.metadata.get('kind') for f in fields(FollowerParams)}
    changes: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition('=')
        if not equals:
            raise ConfigError(f'--set {text!r}: expected name=value')
        if name not in kinds:
            raise ConfigError(unknown_parameter(name, 'follower_node', kinds))
        found = parse_yaml(value, f'--set {name}')
        # The word `true` is one of the references of a heading.
        of_text = kinds[name] == 'str' and isinstance(found, bool)
        changes[name] = value.strip() if of_text else _typed(found, kinds[name])
    return changes


def _typed(value: Any, kind: str | None) -> Any:  # noqa: ANN401 - a value of YAML
    """Value in the type of the parameter; a whole number counts as a float too."""
    if kind == 'float' and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if kind == 'float' and isinstance(value, str):
        try:
            return float(value)  # YAML takes 1e-3 for a text
        except ValueError:
            return value
    if kind == 'floats' and isinstance(value, list):
        return [float(v) if isinstance(v, int) and not isinstance(v, bool) else v for v in value]
    return value


def replay_summary(result: ReplayResult | ReplayedRun, described: Description) -> dict[str, Any]:
    """Summary of a replay in plain values; hashes only for a replay by message."""
    states, receipts = result.counts
    hashes = {'sha256': dict(result.sha256)} if isinstance(result, ReplayResult) else {}
    return {
        'vehicle': result.vehicle,
        'configuration': result.params.configuration,
        'estimates': states,
        'receipts': receipts,
        'verdicts': dict(result.verdicts),
        'taken': dict(result.taken),
        **hashes,
        'divergence': result.divergence or None,
        'health': span_of_health(result.health).to_dict(),
        'engine_version': {'recorded': described.engine_version, 'replayed': ENGINE_VERSION},
        'retired_parameters': described.retired_texts(),
    }


def write_replay(path: Path, result: ReplayResult, source: Bag) -> Path:
    """Write the published messages of a replay to a new bag, each at its own stamp.

    Raises
    ------
    BagError
        When the bag exists or cannot be written.
    """
    info: Mapping[str, object] = {
        'replay_of': str(source.path),
        'mission': source.run_info.get('mission', ''),
        'engine_version': ENGINE_VERSION,
        'configuration': result.params.configuration,
        'parameters': to_mapping(result.params),
        'sha256': dict(result.sha256),
        'verdicts': dict(result.verdicts),
    }
    with BagWriter(path, info) as writer:
        with_model = result.published[MODEL] or result.published[IDENTIFICATION]
        written = (*_TOPICS, *_MODEL_TOPICS) if with_model else _TOPICS
        for topic, type_name in of_vehicle(result.vehicle, written).items():
            writer.add_topic(topic, type_name)
        for output in result.outputs:
            writer.write(output.topic, output.data, output.stamp_ns)
    return path
