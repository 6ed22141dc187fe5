"""File with the state of a navigation, from which a restarted node goes on.

It is written beside its place and renamed, so that a process killed in the middle, or a full disk,
leaves the older one. Whatever is wrong with it, the node starts as without one, and says why.
"""

from __future__ import annotations

import os
import stat
from dataclasses import replace
from pathlib import Path

from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.restart import age_problem, saved_problem, vehicle_problem
from polar_nav_core.engine.saved import MOST_BYTES, SavedState, SavedStateError, pack, unpack

from .navigation_health import Logger
from .stamps import NS


class StateStore:
    """Saves the state of an engine every few seconds of stamp time.

    Parameters
    ----------
    path : Path
        The file.
    period_s : float
        Stamp time between two saves.
    max_age_s : float
        Oldest state from which navigation goes on.
    logger : Logger
    vehicle : str
        Name of the vehicle: a state of another one is left; empty: of any.

    Attributes
    ----------
    status : str
        Sentence about the last save and the restart, for diagnostics.
    """

    def __init__(
        self, path: Path, period_s: float, max_age_s: float, logger: Logger, vehicle: str = ''
    ) -> None:
        self._path = path
        self._period_ns = round(period_s * NS)
        self._max_age_s = max_age_s
        self._logger = logger
        self._vehicle = vehicle
        self._due_ns: int | None = None
        self._failed = False
        self.status = 'not saved yet'
        self._found = self._load()

    @property
    def problem(self) -> str:
        """Sentence on a state that could not be saved; empty where it was, or none was due."""
        return f'{self._path}: {self.status}' if self._failed else ''

    @property
    def has_state(self) -> bool:
        """Whether a saved state waits for the first IMU sample."""
        return self._found is not None

    def take(self, params: EngineParams, stamp_ns: int) -> SavedState | None:
        """State to go on from at the first IMU sample's stamp [ns]; None else."""
        saved, self._found = self._found, None
        if saved is None:
            return None
        too_old = age_problem(saved, stamp_ns, self._max_age_s)
        unfit = vehicle_problem(saved, self._vehicle) or saved_problem(params, saved)
        if too_old or unfit:
            self._logger.warning(f'{self._path}: not restored: {too_old or unfit}')
            if not too_old:
                self._keep_aside()
            return None
        age_s = saved.away_s(stamp_ns)
        self.status = f'restored, {age_s:.1f} s old'
        self._logger.info(f'{self._path}: navigation goes on from a state of {age_s:.1f} s ago')
        return saved

    def save_if_due(self, engine: Engine, stamp_ns: int) -> None:
        """Save once a period; ``stamp_ns`` is the newest IMU sample's."""
        if self._due_ns is None:
            self._due_ns = stamp_ns + self._period_ns
        if stamp_ns >= self._due_ns:
            self._due_ns = stamp_ns + self._period_ns
            self.save(engine)

    def save(self, engine: Engine) -> None:
        """Write the state of an engine that navigates; a failure is logged once."""
        saved = engine.saved()
        if saved is None:
            return
        try:
            _write(self._path, pack(replace(saved, vehicle=self._vehicle)))
        except OSError as error:
            self.status = f'not saved: {error}'
            if not self._failed:
                self._logger.error(f'{self._path}: the state cannot be saved: {error}')
            self._failed = True
            return
        self._failed = False
        self.status = f'saved at {saved.stamp_ns / NS:.1f} s'

    def _load(self) -> SavedState | None:
        try:
            return unpack(_read(self._path))
        except FileNotFoundError:
            self._logger.info(f'{self._path}: no saved state, a first start')
        except (OSError, SavedStateError) as error:
            self._logger.warning(f'{self._path}: not restored: {error}')
            self._keep_aside()
        return None

    def _keep_aside(self) -> None:
        """Keep a file that this program cannot use: the next save would replace it."""
        aside = self._path.with_name(f'{self._path.name}.aside')
        try:
            if self._path.is_file():
                self._path.replace(aside)
                self._logger.warning(f'{self._path}: kept as {aside.name}, a first start')
        except OSError as error:
            self._logger.warning(f'{self._path}: cannot be kept aside: {error}')


def _read(path: Path) -> bytes:
    """Bytes of a regular file of bounded size."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(handle, 'rb') as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise SavedStateError('it is no regular file')
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise SavedStateError(f'more than {MOST_BYTES >> 20} MiB are no saved state')
    return data


def _write(path: Path, data: bytes) -> None:
    """Replace a file as a whole: after a kill or a loss of power it is the old or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f'.{path.name}.new')
    with beside.open('wb') as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
