"""Record of fixes that were decided on, by which copies of them are recognized.

A fix is the measurement of one moment: its time of validity is its name, and its number and its
content must belong to it. A number alone is no name, as a leader that was restarted counts from 0
again and 16 bits wrap; so nobody can use up the numbers of fixes to come. Times in packets wrap,
too, after 4.97 days: a packet recorded then has the same bytes, so contents are compared with
those of one wrap before as well.
"""

from __future__ import annotations

import hashlib
import struct
from array import array
from bisect import bisect_left, bisect_right

from ..link.fields import TICK_NS, WRAP
from .events import Fix
from .verdicts import Verdict

_SPARE = 1024
"""Entries that are dropped at a time."""


def content_of(fix: Fix) -> int:
    """Hash (64 bits) of what a filter uses of a fix, but for its number and its times.

    That is the position with its covariance, the vector from the leader and the heading of its
    array, or the range and the bearing with the pose of the station. The name of the sender is
    free text, and not part of it.
    """
    polar = fix.polar
    if polar is None:
        heading = struct.pack('<d', fix.array_heading)
        parts = fix.r_e.tobytes(), fix.covariance_e.tobytes(), fix.relative_e.tobytes(), heading
        return _hash(b''.join(parts))
    pose = (*polar.station, polar.station_heading)
    return _hash(struct.pack('<6d', *pose, polar.range, polar.bearing))


def _name_of(fix: Fix) -> int:
    """Hash (64 bits) of the sender and its number of the fix."""
    return _hash(f'{fix.sequence} {fix.source}'.encode())


def _hash(data: bytes) -> int:
    return int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), 'little')


class FixRecord:
    """Validity, name and content of the newest fixes of one kind, ordered by validity.

    Parameters
    ----------
    kept : int
        Most entries; the oldest ones are dropped.
    """

    def __init__(self, kept: int) -> None:
        self._kept = kept
        self._ticks = array('q')
        self._names = array('Q')
        self._contents = array('Q')

    def __len__(self) -> int:
        return len(self._ticks)

    def add(self, fix: Fix, validity_ns: int) -> None:
        """Store a fix whose packet states this time of validity [ns]."""
        tick = validity_ns // TICK_NS
        place = bisect_right(self._ticks, tick)
        self._ticks.insert(place, tick)
        self._names.insert(place, _name_of(fix))
        self._contents.insert(place, content_of(fix))
        if len(self._ticks) > self._kept + _SPARE:
            for column in (self._ticks, self._names, self._contents):
                del column[:_SPARE]

    def copy_of(self, fix: Fix, validity_ns: int, *, numbers: bool) -> Verdict | None:
        """DUPLICATE or REPLAYED for a copy of a stored fix; None for another one.

        Parameters
        ----------
        fix : Fix
        validity_ns : int
            As its packet states it [ns].
        numbers : bool
            Whether a number and a time that are stored make a copy, whatever the content.
        """
        tick = validity_ns // TICK_NS
        name, content = 0, None
        if not self._ticks or (self._ticks[-1] < tick and tick - WRAP < self._ticks[0]):
            return None  # nearly always
        for then in (tick, tick - WRAP):
            place = bisect_left(self._ticks, then)
            while place < len(self._ticks) and self._ticks[place] == then:
                if content is None:
                    name, content = _name_of(fix), content_of(fix)
                same_number = then == tick and self._names[place] == name
                if same_number and numbers:
                    return Verdict.DUPLICATE
                if self._contents[place] == content:
                    return Verdict.DUPLICATE if same_number else Verdict.REPLAYED
                place += 1
        return None

    def contradicts(self, fix: Fix, validity_ns: int) -> bool:
        """Whether a fix of the same number and time is stored, and has another content."""
        tick, name = validity_ns // TICK_NS, _name_of(fix)
        first, behind = bisect_left(self._ticks, tick), bisect_right(self._ticks, tick)
        found = [k for k in range(first, behind) if self._names[k] == name]
        return bool(found) and content_of(fix) not in [self._contents[k] for k in found]

    def pack(self) -> bytes:
        """Bytes of all entries, for `unpack`."""
        return b''.join(column.tobytes() for column in (self._ticks, self._names, self._contents))

    def unpack(self, data: bytes) -> None:
        """Replace all entries by packed ones.

        Raises
        ------
        ValueError
            For bytes that are none of a record.
        """
        size, rest = divmod(len(data), 24)
        if rest:
            raise ValueError('a record of fixes has the wrong length')
        columns = array('q'), array('Q'), array('Q')
        for number, column in enumerate(columns):
            column.frombytes(data[8 * size * number : 8 * size * (number + 1)])
        if any(a > b for a, b in zip(columns[0], columns[0][1:], strict=False)):
            raise ValueError('a record of fixes is not in order')
        self._ticks, self._names, self._contents = columns
