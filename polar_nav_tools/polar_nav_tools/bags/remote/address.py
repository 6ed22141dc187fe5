"""Path of a bag at an address: what this project asks of a path, answered by a storage.

An address is written ``scheme://rest``. A path of the standard library makes ``scheme:/rest`` of
it, which is the same path here: no file of a command line is called so.
"""

from __future__ import annotations

import errno
import io
import os
import re
import stat
from collections.abc import Generator
from pathlib import Path, PosixPath
from typing import Any
from weakref import WeakValueDictionary

from ..errors import WrongRequestError
from .copy import SparseCopy, Stream
from .storage import Found, look, matching

_ADDRESS = re.compile(r'([A-Za-z][A-Za-z0-9+.-]+):/+(?=[^/])')
_MOST_REMEMBERED = 1000

_looked: dict[str, Found | None] = {}
_copies: WeakValueDictionary[str, SparseCopy] = WeakValueDictionary()


def is_address(text: str | Path) -> bool:
    """Whether a text or path is an address, and not that of a file of this machine."""
    match = _ADDRESS.match(str(text))
    return match is not None and match[1].lower() != 'file'


def bag_path(path: str | Path) -> Path:
    """Path of a bag: one that is read over the network if it is an address."""
    if isinstance(path, RemotePath):
        return path
    if is_address(path):
        return RemotePath(path)
    match = _ADDRESS.match(str(path))
    return Path(path) if match is None else Path('/' + str(path)[match.end() :])


def is_remote(path: Path) -> bool:
    """Whether a path of a bag is at an address."""
    return isinstance(path, RemotePath)


class RemotePath(PosixPath):
    """Path at an address; its text is the address. It can be read only."""

    @property
    def url(self) -> str:
        """The address."""
        scheme, *rest = self.parts
        return f'{scheme}//{"/".join(rest)}'

    def __str__(self) -> str:
        return self.url

    def __fspath__(self) -> str:
        return self.url

    def __reduce__(self) -> tuple[Any, ...]:
        return RemotePath, (self.url,)

    def found(self, *, again: bool = False) -> Found:
        """Return what lies here; asked once unless `again`.

        Raises
        ------
        BagError
            If nothing does, or the storage cannot be asked.
        """
        known = None if again else _looked.get(self.url)
        if known is None:
            known = look(self.url)
            remember(known)
        return known

    def copy_here(self) -> SparseCopy:
        """Return the local copy with holes; the same one as long as somebody holds it."""
        copy = _copies.get(self.url)
        if copy is None or copy.found != self.found():
            copy = _copies[self.url] = SparseCopy(self.found())
        return copy

    def is_absolute(self) -> bool:
        """Return True."""
        return True

    def absolute(self) -> RemotePath:
        """Return itself."""
        return self

    def resolve(self, strict: bool = False) -> RemotePath:  # noqa: ARG002 - as a path has it
        """Return itself."""
        return self

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:  # noqa: ARG002 - the same
        """Return kind and size."""
        found = self._found_or_none()
        if found is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        mode = (stat.S_IFDIR if found.is_folder else stat.S_IFREG) | 0o444
        return os.stat_result((mode, 0, 0, 1, 0, 0, found.size, 0, 0, 0))

    def exists(self) -> bool:
        """Return whether something lies here."""
        return self._found_or_none() is not None

    def is_dir(self) -> bool:
        """Return whether it is a folder."""
        found = self._found_or_none()
        return found is not None and found.is_folder

    def is_file(self) -> bool:
        """Return whether it is an object."""
        found = self._found_or_none()
        return found is not None and not found.is_folder

    def glob(self, pattern: str) -> Generator[RemotePath]:
        """Yield what matches below here."""
        for found in matching(f'{self.url}/{pattern}'):
            remember(found)
            yield RemotePath(found.url)

    def iterdir(self) -> Generator[RemotePath]:
        """Yield what lies in this folder."""
        yield from self.glob('*')

    def open(self, mode: str = 'r', *_: Any, **__: Any) -> Any:  # noqa: ANN401 - as a path has it
        """Open it for reading, as bytes or as UTF-8 text."""
        if set(mode) - set('rbt'):
            raise OSError(errno.EROFS, 'an address can only be read', str(self))
        if self.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(self))
        stream = Stream(self.copy_here())
        if 'b' in mode:
            return stream
        return io.TextIOWrapper(io.BufferedReader(stream), encoding='utf-8')

    def _found_or_none(self) -> Found | None:
        if self.url in _looked:
            return _looked[self.url]
        try:
            return self.found()
        except WrongRequestError as error:
            if not isinstance(error.__cause__, FileNotFoundError):
                raise
            _remember(self.url, None)
            return None


def remember(found: Found) -> None:
    """Remember what lies at an address, so that it is asked once."""
    _remember(found.url, found)


def _remember(url: str, found: Found | None) -> None:
    if len(_looked) >= _MOST_REMEMBERED:
        _looked.clear()
    _looked[url] = found
