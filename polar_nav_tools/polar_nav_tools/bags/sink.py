"""Output file that grows by whole records, passed to the operating system at once."""

from __future__ import annotations

import contextlib
import fcntl
import os
from io import UnsupportedOperation
from pathlib import Path
from typing import Self

from .errors import BagError, WrongRequestError
from .rosbag2_metadata import FILE_NAME


class Sink:
    """Write-only file without a buffer, for `mcap.writer.Writer`.

    Every call of `write` brings whole MCAP records and ends in the kernel before it returns, so
    killing the process loses nothing of it. A write that fails (disk full) is undone, so the file
    ends behind a whole record. While it is open it is locked, which `is_written` sees.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        with contextlib.suppress(OSError):  # some file systems have no locks
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._size = 0
        self.closed = False

    @classmethod
    def of_new_bag(cls, directory: Path) -> Self:
        """Make the directory of a bag and return the sink of the file in it.

        Raises
        ------
        BagError
            If the directory exists, has no name or cannot be made.
        """
        name = directory.name
        if not name:
            raise BagError(f'{directory}: a bag needs a name')
        try:
            directory.mkdir(parents=True)
            return cls(directory / f'{name}_0.mcap')
        except FileExistsError as error:
            raise WrongRequestError(
                f'{directory} exists already; a bag is never overwritten'
            ) from error
        except OSError as error:
            raise BagError(f'{directory}: cannot make this bag ({error.strerror})') from error

    @classmethod
    def of_next_file(cls, directory: Path) -> Self:
        """Return the sink of another file of a bag; the first one where there is no bag.

        A metadata.yaml that does not name this file is removed: who reads the bag before it is
        finished again finds all files.

        Raises
        ------
        BagError
            If it cannot be made.
        """
        if not directory.is_dir():
            return cls.of_new_bag(directory)
        name = directory.name
        number = 0
        while (directory / f'{name}_{number}.mcap').exists():
            number += 1
        try:
            sink = cls(directory / f'{name}_{number}.mcap')
            (directory / FILE_NAME).unlink(missing_ok=True)
            return sink
        except OSError as error:
            why = error.strerror
            raise BagError(f'{directory}: cannot go on with this bag ({why})') from error

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Append bytes; raises OSError if they do not fit, with the file unchanged."""
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self._fd, view) :]
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, self._size)
                os.lseek(self._fd, self._size, os.SEEK_SET)
            raise
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._size

    def flush(self) -> None:
        """Do nothing: no byte is buffered."""

    def sync(self) -> None:
        """Wait until the bytes are on the disk, for a loss of power."""
        os.fdatasync(self._fd)

    def is_in_place(self) -> bool:
        """Whether the file still exists under its name: writes succeed without it."""
        own = os.fstat(self._fd)
        try:
            named = self.path.stat()
        except OSError:
            return False
        return (own.st_dev, own.st_ino) == (named.st_dev, named.st_ino)

    def close(self) -> None:
        """Close the file."""
        if not self.closed:
            self.closed = True
            os.close(self._fd)

    def read(self, size: int = -1) -> bytes:
        """Refuse: the file is write-only (mcap's type of a stream has this method)."""
        raise UnsupportedOperation(f'read {size} bytes of {self.path}')


def is_written(path: Path) -> bool:
    """Whether a process of this computer has a `Sink` of a file open."""
    with path.open('rb') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # no locks on this file system
            return False
    return False
