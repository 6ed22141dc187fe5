"""Storages behind addresses, through fsspec: what lies there, and bytes of it.

Every error of a storage's library becomes one sentence that names the address.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from ..errors import BagError, WrongRequestError

_PACKAGES = {
    's3': 's3fs',
    's3a': 's3fs',
    'http': 'aiohttp',
    'https': 'aiohttp',
    'gs': 'gcsfs',
    'gcs': 'gcsfs',
    'abfs': 'adlfs',
    'az': 'adlfs',
}
"""Packages with which fsspec reads an address that it does not read by itself."""
_WITH_FSSPEC = ('s3fs', 'gcsfs')
"""Those of them that come in the versions of fsspec, and go with their own only."""
_STATES = (
    'ETag', 'etag', 'Content-MD5', 'md5Hash', 'Last-Modified', 'LastModified', 'mtime', 'created',
)  # fmt: skip
"""What a storage says of the state of an object, best first, by its names in fsspec."""
_AT_ONCE = 8
"""Most requests at the same time."""
_NO_PARTS = (
    'the server sends a file as a whole only (it answers no request for a range), '
    'which a bag is not read from; copy the bag here'
)


@dataclass(frozen=True)
class Found:
    """What lies at an address: an object, or a folder of objects.

    Attributes
    ----------
    url : str
    size : int
        Of an object [bytes].
    is_folder : bool
    state : str
        By what the storage tells one content of the object from another, mostly its ETag; empty
        if it says nothing.
    """

    url: str
    size: int = 0
    is_folder: bool = False
    state: str = ''


def look(url: str) -> Found:
    """Return what lies at an address, by one request if it is an object.

    Raises
    ------
    BagError
        If nothing does, or the storage cannot be asked.
    """
    with _explained(url):
        fs, path = _of(url)
        return _found(url, fs.info(path, **_fresh(fs)))


def matching(pattern: str) -> list[Found]:
    """Return the objects and folders whose addresses match a pattern, in order.

    Raises
    ------
    BagError
        If the storage cannot be asked.
    """
    with _explained(pattern):
        fs, path = _of(pattern)
        # What was listed before may be gone; the listings of this call are kept for it.
        fs.invalidate_cache()
        found = fs.glob(path, detail=True)
        scheme = pattern.partition('://')[0]
        return [
            _found(name if '://' in name else f'{scheme}://{name.lstrip("/")}', info)
            for name, info in sorted(found.items())
        ]


def fetched(url: str, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
    """Bytes of an object from one offset to before another, a request for each range.

    Raises
    ------
    BagError
        If the storage cannot be read, or sends something else than was asked for.
    """
    with _explained(url):
        fs, path = _of(url)
        starts, ends = [a for a, _ in ranges], [b for _, b in ranges]
        # Servers with short queues drop connections that come at once, and seconds pass.
        more = {'batch_size': _AT_ONCE} if fs.async_impl else {}
        got = fs.cat_ranges([path] * len(ranges), starts, ends, on_error='raise', **more)
    for (start, end), data in zip(ranges, got, strict=True):
        if len(data) > end - start:
            raise BagError(f'{url}: {_NO_PARTS}')
        if len(data) < end - start:
            raise BagError(f'{url} was changed while it was read: it ends within a range')
    return list(got)


def last_bytes(found: Found, size: int) -> bytes:
    """Return the last bytes of an object, or all; from a server, only if it can send parts.

    Raises
    ------
    BagError
        As `fetched`.
    """
    start = max(0, found.size - size)
    if start and found.url.startswith(('http://', 'https://')):
        with _explained(found.url):
            fs, path = _of(found.url)
            # Ends where more comes than was asked for, not after a whole bag.
            with fs.open(path, 'rb', size=found.size, cache_type='none') as file:
                file.seek(start)
                return bytes(file.read(found.size - start))
    return fetched(found.url, [(start, found.size)])[0]


def _of(url: str) -> tuple[Any, str]:
    """File system and path of an address."""
    from fsspec.core import url_to_fs

    fs, path = url_to_fs(url)
    return fs, path


def _fresh(fs: Any) -> dict[str, bool]:  # noqa: ANN401 - a file system of fsspec
    """Options by which a file system asks again, where it remembers."""
    return {'refresh': True} if 's3' in _protocols(fs) else {}


def _protocols(fs: Any) -> tuple[str, ...]:  # noqa: ANN401 - a file system of fsspec
    return (fs.protocol,) if isinstance(fs.protocol, str) else tuple(fs.protocol)


def _found(url: str, info: Mapping[str, Any]) -> Found:
    is_folder = info.get('type') == 'directory'
    size = info.get('size')
    if size is None and not is_folder:
        raise BagError(f'{url}: the server does not say how large it is')
    if info.get('partial') is False:
        raise BagError(f'{url}: {_NO_PARTS}')
    state = next((f'{name} {_plain(info[name])}' for name in _STATES if info.get(name)), '')
    return Found(url, int(size or 0), is_folder, '' if is_folder else state)


def _plain(value: object) -> object:
    """State in one form: a listing may have the seconds of what a look has as a date."""
    return value.timestamp() if isinstance(value, datetime) else value


@contextmanager
def _explained(url: str) -> Iterator[None]:
    """Turn errors of a storage into sentences that name the address."""
    try:
        yield
    except (BagError, KeyboardInterrupt):
        raise
    except ImportError as error:
        raise WrongRequestError(f'{url}: {_what_is_missing(url, error)}') from error
    except ValueError as error:
        if 'rotocol not known' in str(error):
            scheme = url.partition('://')[0]
            raise WrongRequestError(f'{url}: {scheme}:// is no storage that is known') from error
        if 'range request' in str(error) or 'more bytes' in str(error):
            raise BagError(f'{url}: {_NO_PARTS}') from error
        raise BagError(f'{url}: cannot be read ({_reason(error)})') from error
    except FileNotFoundError as error:
        if url.startswith(('http://', 'https://')) and _is_no_answer(error.__cause__):
            raise BagError(f'{url}: cannot be read ({_reason(error.__cause__)})') from error
        bucket = ': there is no such bucket' if 'bucket' in str(error) else ''
        raise WrongRequestError(f'{url} does not exist{bucket}') from error
    except Exception as error:
        raise BagError(f'{url}: cannot be read ({_reason(error)})') from error


def _what_is_missing(url: str, error: ImportError) -> str:
    from fsspec import __version__

    scheme = url.partition('://')[0]
    package = _PACKAGES.get(scheme)
    if package is None:
        return f'{scheme}:// needs a package that is not installed ({_line(error)})'
    exact = f'{package}=={__version__}' if package in _WITH_FSSPEC else package
    return f'{scheme}:// needs the package {package} (pip install {exact})'


def _is_no_answer(cause: BaseException | None) -> bool:
    """Whether fsspec calls a page missing because of something else than the server's 404."""
    return cause is not None and getattr(cause, 'status', None) not in (404, 410)


def _reason(error: BaseException | None) -> str:
    """One line of what went wrong, in words of the storage."""
    if error is None:
        return 'nothing is known'
    name = type(error).__name__
    if name in ('NoCredentialsError', 'PartialCredentialsError', 'NoCredentials'):
        return 'no credentials: AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or a profile'
    if isinstance(error, asyncio.TimeoutError | TimeoutError):
        return 'no answer in time'
    status = getattr(error, 'status', None)
    if isinstance(error, PermissionError) or status in (401, 403):
        return f'access denied: {_line(error)}'
    return _line(error)


def _line(error: BaseException) -> str:
    text = str(getattr(error, 'strerror', None) or error) or type(error).__name__
    return ' '.join(text.split())
