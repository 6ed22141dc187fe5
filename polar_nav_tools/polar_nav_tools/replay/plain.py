"""Inputs of recordings that can be run as arrays in the strapdown mode."""

from __future__ import annotations

from polar_nav_core.errors import ConfigError

from ..bags import Bag
from .arrays import SinsArrays, StationArrays
from .arrays_from_bag import Progress, load_arrays


def plain_arrays(
    bag: Bag, vehicle: str, done: str, *, truth: bool = False, progress: Progress | None = None
) -> SinsArrays:
    """Inputs of a follower of mode sins; ``done`` is what one can do with them, for the refusal.

    Raises
    ------
    ConfigError
        As `whole_arrays`, and for one of station mode.
    """
    arrays = whole_arrays(bag, vehicle, done, truth=truth, progress=progress)
    if isinstance(arrays, SinsArrays):
        return arrays
    raise ConfigError(f'{bag.path}: only recordings of mode sins can be {done}, not of station')


def whole_arrays(
    bag: Bag, vehicle: str, done: str, *, truth: bool = False, progress: Progress | None = None
) -> SinsArrays | StationArrays:
    """Inputs of a follower of either mode; ``done`` is what one can do with them.

    Raises
    ------
    ConfigError
        For a recording that has to be replayed by message: with services called on the way,
        restarts, or sources.
    """
    arrays = load_arrays(bag, vehicle, truth=truth, progress=progress)
    if arrays is not None:
        return arrays
    raise ConfigError(
        f'{bag.path}: only recordings whose inputs are plain streams can be {done}: not those '
        'with `sources`, or in which the filter was started again; `--map` reads them as any bag'
    )
