"""Bags that patterns name, here and at addresses, and what tells their contents apart.

A pattern stands for ``.mcap`` files and folders with a bag. Files of one bag that was split
(``run/run_0.mcap``, ``run/run_1.mcap``) stand for their folder.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from polar_nav_core.errors import ConfigError

from ..bags import files
from ..bags.errors import BagError
from ..bags.remote.address import RemotePath, bag_path, is_remote, remember
from ..bags.remote.storage import matching
from ..bags.rosbag2_metadata import FILE_NAME
from ..bags.run_folder import OUTCOME_NAME, RUN_FOLDER

_MAGIC = re.compile(r'[*?[]')
_SPLIT = re.compile(r'(.*)_\d+\.mcap')


@dataclass(frozen=True)
class FarFile:
    """What a storage says of one object: address, size [bytes], and its state, mostly an ETag."""

    url: str
    size: int
    state: str


@dataclass(frozen=True)
class NearFile:
    """A file of this machine and its size [bytes]; in a key it counts by its bytes alone."""

    path: Path
    size: int

    def key_content(self) -> Path:
        """Its bytes."""
        return self.path


@dataclass(frozen=True)
class NamedBag:
    """A bag that was named.

    Attributes
    ----------
    path : Path
        Of the bag, from the root of the file system or storage.
    contents : tuple of NearFile and FarFile
        What its files are known by.
    """

    path: Path
    contents: tuple[NearFile | FarFile, ...]

    @property
    def is_certain(self) -> bool:
        """Whether another content would be noticed: a storage may say nothing but a size."""
        return all(isinstance(f, NearFile) or f.state for f in self.contents)


def has_pattern(text: str | Path) -> bool:
    """Whether a text stands for any number of bags; one that exists is what it is called."""
    path = Path(text)
    if _MAGIC.search(str(path)) is None:
        return False
    # Of an address everything behind the question mark may be a key.
    if is_remote(bag_path(path)):
        return _MAGIC.search(str(path).partition('?')[0]) is not None
    return not path.exists()


def expanded(words: Iterable[str | Path]) -> list[Path]:
    """Paths of bags: patterns are replaced by what they match, in order; each bag once.

    Raises
    ------
    ConfigError
        When a pattern matches nothing.
    """
    out: dict[Path, None] = {}
    for word in words:
        if not has_pattern(word):
            out[bag_path(word)] = None
            continue
        found = _matches(bag_path(word))
        if not found:
            raise ConfigError(f'{bag_path(word)}: no bag matches')
        out |= dict.fromkeys(found)
    return list(out)


def named(path: Path) -> NamedBag:
    """Return a bag with what tells its content from others, by what storages last said of it.

    Raises
    ------
    BagError
        When it does not exist, or there is no bag.
    """
    listing = files.find(path, again=False)
    beside = [path / FILE_NAME, path / RUN_FOLDER / OUTCOME_NAME] if path.is_dir() else []
    contents = [*listing.paths, *(p for p in beside if p.is_file())]
    return NamedBag(path.absolute(), tuple(_content(p.absolute()) for p in contents))


def _content(path: Path) -> NearFile | FarFile:
    if not isinstance(path, RemotePath):
        return NearFile(path, path.stat().st_size)
    found = path.found()
    return FarFile(path.url, found.size, found.state)


def _matches(pattern: Path) -> list[Path]:
    if isinstance(pattern, RemotePath):
        found: list[tuple[Path, bool]] = []
        for one in matching(pattern.url):
            remember(one)
            found.append((RemotePath(one.url), one.is_folder))
    else:
        # Path.glob takes no pattern from the root.
        names = sorted(glob.glob(str(pattern), recursive=True))  # noqa: PTH207
        found = [(Path(n), Path(n).is_dir()) for n in names]
    bags = [path for path, is_folder in found if (not is_folder and path.suffix == '.mcap')]
    folders = [path for path, is_folder in found if is_folder and _is_bag(path)]
    return sorted({*_unsplit(bags, folders), *folders})


def _is_bag(folder: Path) -> bool:
    """Whether a folder is a bag itself."""
    if any(folder.glob('*.mcap')):
        return True
    try:
        files.find(folder)
    except BagError:
        return False
    return True


def _unsplit(bags: Sequence[Path], folders: Sequence[Path]) -> list[Path]:
    """Files, those of a folder that is there as a bag left out, split ones as their folder."""
    parts: dict[Path, list[Path]] = {}
    for path in bags:
        match = _SPLIT.fullmatch(path.name)
        if path.parent not in folders and match is not None and match[1] == path.parent.name:
            parts.setdefault(path.parent, []).append(path)
    split = {folder for folder, held in parts.items() if len(held) > 1}
    return [
        *split,
        *(p for p in bags if p.parent not in split and p.parent not in folders),
    ]
