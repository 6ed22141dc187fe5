"""QoS that a topic is published with: the one with which it was recorded.

Recorders store the profiles of a topic's publishers as YAML, with words (metadata version 9) or
the numbers of `rmw_qos_profile_t` (before).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from polar_nav_core.errors import ConfigError
from polar_nav_core.user_files import read_yaml

from ..bags.rosbag2_metadata import FILE_NAME, ROOT_KEY

QUEUE_DEPTH = 2000
"""Of volatile topics: a burst is sent whole, whatever the depth of the recorded publisher was."""
_LATCHED = ('/tf_static', '/robot_description')
_MOST_TEXT = 100_000
_S = 1_000_000_000
_FOREVER_NS = 9223372036 * _S
_WORDS = {
    'reliability': ('system_default', 'reliable', 'best_effort'),
    'durability': ('system_default', 'transient_local', 'volatile'),
    'history': ('system_default', 'keep_last', 'keep_all'),
    'liveliness': ('system_default', 'automatic', 'manual_by_node', 'manual_by_topic'),
}


@dataclass(frozen=True)
class Offer:
    """Profile of a publisher; durations in ns, None for no limit."""

    reliable: bool = True
    latched: bool = False
    keep_all: bool = False
    depth: int = QUEUE_DEPTH
    deadline_ns: int | None = None
    lifespan_ns: int | None = None
    manual_liveliness: bool = False
    lease_ns: int | None = None

    def words(self) -> str:
        """Return the profile in words, for people."""
        reliability = 'reliable' if self.reliable else 'best effort'
        return f'{reliability}, transient local' if self.latched else reliability


def offer_of(topic: str, profiles: Any) -> Offer:  # noqa: ANN401 - whatever stands in a file
    """Return the profile to publish a topic with.

    Several publishers become one that serves the subscribers of each: best effort only if all
    were, transient local if one was. Without a profile it is reliable, and transient local for the
    topics that always are.

    Parameters
    ----------
    topic : str
    profiles : str, sequence or None
        ``offered_qos_profiles`` of the bag, as YAML or already read.
    """
    found = [_offer(p) for p in _listed(profiles)]
    if not found:
        latched = topic in _LATCHED
        return Offer(latched=latched, depth=100 if latched else QUEUE_DEPTH)
    first = found[0]
    same = all(replace(f, depth=first.depth, keep_all=first.keep_all) == first for f in found)
    merged = Offer(
        reliable=any(f.reliable for f in found),
        latched=any(f.latched for f in found),
        keep_all=any(f.keep_all for f in found),
        depth=max(f.depth for f in found),
    )
    if same:
        merged = replace(first, keep_all=merged.keep_all, depth=merged.depth)
    # A late subscriber of a latched topic gets as many messages as it got then; of others the
    # depth only limits a burst.
    return merged if merged.latched else replace(merged, depth=max(merged.depth, QUEUE_DEPTH))


def profiles_of_folder(path: Path) -> dict[str, Any]:
    """Return the recorded profiles by topic from the metadata of a bag's folder, if there are."""
    folder = path if path.is_dir() else path.parent
    file = folder / FILE_NAME
    if not file.is_file():
        return {}
    try:
        content = read_yaml(file)
    except ConfigError:
        return {}  # the reader of the bag reports it
    root = content.get(ROOT_KEY) if isinstance(content, Mapping) else None
    entries = root.get('topics_with_message_count') if isinstance(root, Mapping) else None
    found: dict[str, Any] = {}
    for entry in entries if isinstance(entries, list) else ():
        about = entry.get('topic_metadata') if isinstance(entry, Mapping) else None
        if isinstance(about, Mapping) and isinstance(about.get('name'), str):
            found[about['name']] = about.get('offered_qos_profiles')
    return found


def _listed(profiles: Any) -> Sequence[Mapping[str, Any]]:  # noqa: ANN401
    content = profiles
    if isinstance(profiles, str):
        if len(profiles) > _MOST_TEXT:
            return ()
        try:
            content = yaml.safe_load(profiles)
        except (yaml.YAMLError, RecursionError, ValueError):
            return ()
    if not isinstance(content, list):
        return ()
    return [p for p in content if isinstance(p, Mapping)]


def _offer(profile: Mapping[str, Any]) -> Offer:
    depth = profile.get('depth')
    known = isinstance(depth, int) and not isinstance(depth, bool) and 0 < depth < 1_000_000
    return Offer(
        reliable=_word(profile, 'reliability') != 'best_effort',
        latched=_word(profile, 'durability') == 'transient_local',
        keep_all=_word(profile, 'history') == 'keep_all',
        depth=int(str(depth)) if known else 1,
        deadline_ns=_duration(profile.get('deadline')),
        lifespan_ns=_duration(profile.get('lifespan')),
        manual_liveliness=_word(profile, 'liveliness') == 'manual_by_topic',
        lease_ns=_duration(profile.get('liveliness_lease_duration')),
    )


def _word(profile: Mapping[str, Any], name: str) -> str:
    value = profile.get(name)
    words = _WORDS[name]
    if isinstance(value, int) and not isinstance(value, bool):
        return words[value] if 0 <= value < len(words) else ''
    return value if isinstance(value, str) else ''


def _duration(value: Any) -> int | None:  # noqa: ANN401
    """Duration [ns]; None for zero, rmw's infinity and what is no duration."""
    if not isinstance(value, Mapping):
        return None
    s, ns = value.get('sec'), value.get('nsec')
    if not isinstance(s, int) or not isinstance(ns, int):
        return None
    total = s * _S + ns
    return total if 0 < total < _FOREVER_NS else None
