"""A bag played from its first to its last message, or again and again."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from polar_nav_core.errors import ConfigError, PolarNavError

from ..foreign.sources import Source
from ..live.middleware import middleware_environment
from .order import Message, Span, in_order, measure
from .pace import Lag, Timeline, publish_all, with_clock, within
from .selection import Selection, choose
from .tracks import Track, Tracks, find_tracks, messages_of

if TYPE_CHECKING:
    from .player import Player

ANY = 'any'
BEHIND_S = 0.05
"""Lag from which a playback reports that it fell behind [s]."""
_SHORTEST_ROUND_NS = 100_000_000
_SHOWN_EACH_NS = 100_000_000
_FLUSH_S = 2.0
_S = 1_000_000_000

Shown = Callable[[float, float], None]
"""Called with the seconds of the recording that were played, and their total."""


class PlayError(PolarNavError):
    """A bag cannot be played: nobody listens, or no topic can be published."""


@dataclass(frozen=True)
class Options:
    """Options of a playback; `wait` names topics and nodes, or `any`; None is no wait."""

    selection: Selection = field(default_factory=Selection)
    rate: float = 1.0
    clock_hz: float | None = None
    loop: bool = False
    start_s: float = 0.0
    duration_s: float | None = None
    wait: Sequence[str] | None = None
    wait_s: float = 30.0
    build: bool = True
    network: bool = False

    def __post_init__(self) -> None:
        if self.wait is not None and ANY in self.wait and len(self.wait) > 1:
            raise ConfigError(f'--wait: {ANY} stands alone')


@dataclass
class Played:
    """Result of a playback.

    Attributes
    ----------
    path : Path
    tracks : Tracks
    span : Span
        Of the bag.
    first_ns, last_ns : int
        Log times from which and to which was played.
    published, unusable : dict of str to int
        Messages by topic; unusable ones are no CDR.
    lag : Lag
    rounds : int
        Begun ones.
    wall_s : float
    signal : int or None
        That ended it.
    """

    path: Path
    tracks: Tracks
    span: Span
    first_ns: int
    last_ns: int
    published: dict[str, int] = field(default_factory=dict)
    unusable: dict[str, int] = field(default_factory=dict)
    lag: Lag = field(default_factory=Lag)
    rounds: int = 0
    wall_s: float = 0.0
    signal: int | None = None

    def complaints(self) -> list[str]:
        """Return a sentence for each topic or message that was selected and not published."""
        found = [f'{n} is not played: {why}' for n, why in sorted(self.tracks.refused.items())]
        return found + [
            f'{name}: {count} messages are no CDR and were not published'
            for name, count in sorted(self.unusable.items())
        ]

    def remark(self) -> str | None:
        """Return a sentence if messages were published late."""
        largest_s = self.lag.largest_ns / _S
        if largest_s < BEHIND_S:
            return None
        at_s = (self.lag.at_ns - self.span.first_ns) / _S
        return (
            f'it fell behind: a message was published {largest_s:.3f} s late, '
            f'at {at_s:.3f} s of the recording; a smaller --rate or fewer --topics keep up'
        )

    def to_dict(self) -> dict[str, object]:
        """Return values for JSON."""
        lag = self.lag
        return {
            'topics': [
                {
                    'name': t.name,
                    'published_as': t.published,
                    'type': t.type,
                    'qos': t.offer.words(),
                    'messages': self.published.get(t.name, 0),
                }
                for t in self.tracks.playable
            ],
            'not_played': dict(sorted(self.tracks.refused.items())),
            'unusable': dict(sorted(self.unusable.items())),
            'built': {name: str(path) for name, path in sorted(self.tracks.built.items())},
            'messages': sum(self.published.values()),
            'recorded_s': (self.last_ns - self.first_ns) / _S,
            'rounds': self.rounds,
            'wall_s': round(self.wall_s, 3),
            'lag_mean_s': lag.total_ns / max(1, lag.count) / _S,
            'lag_max_s': lag.largest_ns / _S,
            'lag_max_at_s': (lag.at_ns - self.span.first_ns) / _S if lag.largest_ns else None,
            'signal': self.signal,
        }


def play(
    source: Source,
    options: Options,
    say: Callable[[str], None],
    shown: Shown | None = None,
) -> Played:
    """Play a bag with a node of its own, until its end or a signal.

    Parameters
    ----------
    source : Source
    options : Options
    say : callable
        Called with sentences for the user.
    shown : callable, optional
        Called with the progress.

    Raises
    ------
    ConfigError
        For options that do not fit the bag.
    PlayError
        If no topic can be published, or nobody subscribed in time.
    """
    names = choose(source.topics, options.selection)
    result = prepared(source, names, options, say)
    with TemporaryDirectory(prefix='polar_play_') as folder:
        # Before rclpy is loaded: the middleware reads it once.
        os.environ |= middleware_environment(Path(folder), os.environ, network=options.network)
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        from polar_nav_ros.process import Stop

        from .player import Player

        stop = Stop()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node('polar_play', enable_rosout=False, start_parameter_services=False)
        try:
            player = Player(node, result.tracks.playable, clock=options.clock_hz is not None)
            result.tracks.refused |= player.refused
            playable = [t for t in result.tracks.playable if t.name not in player.refused]
            result.tracks.playable = _require_some(playable, result.tracks)
            _perform(source, options, player, result, lambda: stop.signal is not None, shown)
            result.signal = stop.signal
        finally:
            node.destroy_node()
            rclpy.try_shutdown()
    return result


def prepared(
    source: Source, names: dict[str, str], options: Options, say: Callable[[str], None]
) -> Played:
    """Return the playback before its first message: types, publishers' QoS, times.

    Raises
    ------
    ConfigError
        If the time span of the options is empty.
    PlayError
        If no topic can be published.
    """
    tracks = find_tracks(source, names, say, build=options.build)
    _require_some(tracks.playable, tracks)
    chosen = {t.name for t in tracks.playable}
    span = measure(((topic, log_ns) for topic, log_ns, _ in source.fronts()), chosen)
    first_ns = span.first_ns + round(options.start_s * _S)
    last_ns = span.last_ns
    if options.duration_s is not None:
        last_ns = min(last_ns, first_ns + round(options.duration_s * _S))
    if first_ns > span.last_ns:
        length_s = (span.last_ns - span.first_ns) / _S
        raise ConfigError(f'--start {options.start_s:g}: the bag is {length_s:.3f} s long')
    return Played(source.path, tracks, span, first_ns, last_ns)


def rounds_of(source: Source, options: Options, played: Played) -> Iterator[Iterator[Message]]:
    """Yield the messages of each round: one, or without an end with `loop`."""
    chosen = {t.name for t in played.tracks.playable}
    latched = {t.name: t.offer.depth for t in played.tracks.playable if t.offer.latched}
    first_ns, last_ns = played.first_ns, played.last_ns
    for _ in itertools.count() if options.loop else range(1):
        messages = in_order(messages_of(source, chosen), played.span.window_ns)
        messages = within(messages, first_ns, last_ns, latched)
        if options.clock_hz is not None:
            period_ns = max(1, round(options.rate / options.clock_hz * _S))
            messages = with_clock(messages, first_ns, last_ns, period_ns)
        yield messages


def _perform(
    source: Source,
    options: Options,
    player: Player,
    result: Played,
    stopped: Callable[[], bool],
    shown: Shown | None,
) -> None:
    from .player import wait_for_listeners

    missing = wait_for_listeners(
        player.listeners,
        player.matched,
        _awaited(options.wait, result.tracks.playable),
        options.wait_s,
        now_ns=time.monotonic_ns,
        pause=time.sleep,
        stopped=stopped,
    )
    if missing:
        raise PlayError(
            f'{source.path}: no subscription of or to {", ".join(missing)} within '
            f'{options.wait_s:g} s; nothing was played'
        )
    publish = player.publish if shown is None else _showing(player.publish, result, shown)
    begun_ns = start_ns = 0
    round_ns = max(round((result.last_ns - result.first_ns) / options.rate), _SHORTEST_ROUND_NS)
    for messages in rounds_of(source, options, result):
        first = next(messages, None)  # opens the bag, which is no lag
        if not result.rounds:
            begun_ns = start_ns = time.monotonic_ns()
        result.rounds += 1
        whole = publish_all(
            messages if first is None else itertools.chain((first,), messages),
            Timeline(result.first_ns, options.rate, start_ns),
            publish,
            lag=result.lag,
            now_ns=time.monotonic_ns,
            pause=time.sleep,
            stopped=stopped,
        )
        if not whole:
            break
        start_ns += round_ns
    result.wall_s = (time.monotonic_ns() - begun_ns) / _S
    result.published, result.unusable = player.published, player.unusable
    player.flush(_FLUSH_S)


def _showing(
    publish: Callable[[Message], None], result: Played, shown: Shown
) -> Callable[[Message], None]:
    total_s = (result.last_ns - result.first_ns) / _S
    next_ns = 0

    def published(message: Message) -> None:
        nonlocal next_ns
        publish(message)
        now_ns = time.monotonic_ns()
        if now_ns >= next_ns:
            next_ns = now_ns + _SHOWN_EACH_NS
            shown((message.log_ns - result.first_ns) / _S, total_s)

    return published


def _awaited(wait: Sequence[str] | None, tracks: Sequence[Track]) -> list[str] | None:
    """Topics, by name in the bag, and nodes to wait for; empty for any, None for no wait."""
    if wait is None or ANY in wait:
        return None if wait is None else []
    full = [name if name.startswith('/') else f'/{name}' for name in wait]
    by_name = {t.published: t.name for t in tracks}
    return [by_name.get(name, name) for name in full]


def _require_some(playable: list[Track], tracks: Tracks) -> list[Track]:
    if playable:
        return playable
    why = '; '.join(f'{name}: {reason}' for name, reason in sorted(tracks.refused.items()))
    raise PlayError(f'no topic can be played ({why or "the selected topics have no message"})')
