"""Opens a bag for a command, and finds the follower in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from polar_nav_ros.topics import STATE

from ..bags import Bag, BagError, open_bag
from ..bags.errors import WrongRequestError, some_of
from ..terminal.progress import opening_display

if TYPE_CHECKING:
    from ..bags.ahead import Wants
    from ..bags.request import Request

Say = Callable[[str], None]


def follower_of(bag: Bag) -> str:
    """Vehicle of the one follower in a bag, by its estimates or its description on /run_info.

    A leader that navigates by itself has estimates, too; then the descriptions decide.

    Raises
    ------
    BagError
        When there is none, or there are several.
    """
    found = {t.name.split('/')[1] for t in bag.topics.values() if t.count and _is_state(t.name)}
    if len(found) != 1:
        from ..replay.recorded import followers_of

        described = set(followers_of(bag))
        found = found & described or described or found
    if len(found) == 1:
        return found.pop()
    if not found:
        raise BagError(f'{bag.path} has no follower: no message on <vehicle>/{STATE}')
    raise WrongRequestError(
        f'{bag.path} has {len(found)} followers ({some_of(found)}): name one with --vehicle'
    )


def _is_state(topic: str) -> bool:
    return topic.count('/') == 3 and topic.endswith(f'/{STATE}')


def wanted_of(vehicle: str | None, *, truth: bool) -> Wants:
    """Topics that `analyse` reads in a replay, for `open_for` to read on its pass."""

    def wants(bag: Bag) -> Request | None:
        from ..replay.arrays_from_bag import arrays_request

        return arrays_request(bag, vehicle or follower_of(bag), truth=truth)

    return wants


def open_for(path: Path, say: Say, ahead: Wants | None = None, *, whole: bool = False) -> Bag:
    """Bag opened for a command; its problems are reported first.

    With `whole` one at an address is fetched and verified to its last byte.
    """
    with opening_display(path) as progress:
        bag = open_bag(path, progress, ahead=ahead, whole=whole)
    for remark in bag.remarks:
        say(remark)
    for problem in bag.problems:
        say(f'{path}: {problem}')
    return bag
