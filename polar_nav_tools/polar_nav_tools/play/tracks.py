"""Topics of a bag with all that is needed to publish them, or the reason why they cannot be."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..bags.errors import BagError
from ..foreign.sources import Source
from ..foreign.sources.mcap import McapSource
from . import generate
from .offers import Offer, offer_of, profiles_of_folder
from .order import Message
from .schemas import plan

_PROFILES = 'offered_qos_profiles'


@dataclass(frozen=True)
class Track:
    """One topic to play.

    Attributes
    ----------
    name, published : str
        In the bag, and on the graph.
    type : str
    offer : Offer
        QoS of its publisher.
    """

    name: str
    published: str
    type: str
    offer: Offer


@dataclass
class Tracks:
    """Topics to play, those that cannot be played with the reason, and packages built for them."""

    playable: list[Track] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)
    built: dict[str, Path] = field(default_factory=dict)


def find_tracks(
    source: Source,
    names: Mapping[str, str],
    say: Callable[[str], None],
    *,
    build: bool = True,
    folder: Path | None = None,
) -> Tracks:
    """Return what can be played of a bag, after building message packages that are not installed.

    Parameters
    ----------
    source : Source
    names : mapping of str to str
        Names on the graph by names in the bag (`selection.choose`); topics without a message are
        passed over.
    say : callable
        Called with a sentence before a build.
    build : bool
        Whether packages may be built.
    folder : Path, optional
        Cache of built packages; the usual one by default.
    """
    result = Tracks()
    texts: dict[str, str] = {}
    wanted = {n: source.topics[n].type for n in names if source.topics[n].count}
    for name, kind in wanted.items():
        try:
            text = source.text(name)
        except BagError as error:
            result.refused[name] = str(error).removeprefix(f'{source.path}: ')
            continue
        texts.setdefault(kind, text)
    found = plan(texts, generate.has_package)
    needed = set().union(*found.used.values()) if found.used else set()
    failed: dict[str, str] = {}
    if not build:
        failed = dict.fromkeys(needed, 'its package is not installed (--no-build)')
    elif needed:
        result.built, failed = generate.provide(
            [r for r in found.recipes if r.package in needed],
            folder or generate.cache_folder(),
            say,
        )
        generate.load(result.built.values())
    profiles = _profiles(source)
    for name, kind in wanted.items():
        broken = sorted(found.used.get(kind, set()) & failed.keys())
        if name in result.refused:
            continue
        if kind in found.refused:
            result.refused[name] = found.refused[kind]
        elif broken:
            result.refused[name] = f'{kind}: {failed[broken[0]]}'
        else:
            offer = offer_of(name, profiles.get(name))
            result.playable.append(Track(name, names[name], kind, offer))
    return result


def messages_of(source: Source, topics: Collection[str]) -> Iterator[Message]:
    """Yield the messages of some topics in the order of the bag."""
    if isinstance(source, McapSource):
        for name, log_ns, data in source.bag.messages(topics):
            yield Message(name, log_ns, data)
        return
    # The other readers give one topic at a time, by log time.
    yield from heapq.merge(
        *(_records(source, name) for name in sorted(topics)), key=lambda m: m.log_ns
    )


def _records(source: Source, topic: str) -> Iterator[Message]:
    for log_ns, data in source.records(topic):
        yield Message(topic, log_ns, data)


def _profiles(source: Source) -> dict[str, Any]:
    """Recorded QoS by topic: from the channels of the file, else from the metadata beside it."""
    found = profiles_of_folder(source.path)
    if isinstance(source, McapSource):
        for name in source.topics:
            text = source.bag.channel(name).metadata.get(_PROFILES)
            if text:
                found[name] = text
    return found
