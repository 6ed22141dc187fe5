"""Faults of a bag's file: bytes cut off or flipped, for `recover`, `doctor` and every reader."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.errors import ConfigError

from ..bags.errors import BagError, WrongRequestError

_FORM = re.compile(r'(\w+)(?::([^@]+))?')


@dataclass(frozen=True)
class FileFault:
    """One kind of damage.

    Attributes
    ----------
    name, doc : str
    size : float
        Default, in ``unit``.
    unit : str
    apply : callable
        Damaged bytes of bytes, a size and a random generator.
    """

    name: str
    doc: str
    size: float
    unit: str
    apply: Callable[[bytes, float, np.random.Generator], bytes]
    modes: tuple[str, ...] = ('sins', 'station')


@dataclass(frozen=True)
class Damaged:
    """The damaged file, and its faults as on the command line."""

    target: Path
    faults: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Result as values for JSON."""
        return {'path': str(self.target), 'faults': list(self.faults)}


def _truncated(data: bytes, size: float, rng: np.random.Generator) -> bytes:
    del rng
    return data[: round(len(data) * size)]


def _flipped(data: bytes, size: float, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for place in rng.choice(len(data), min(round(size), len(data)), replace=False):
        out[place] ^= 1 << int(rng.integers(8))
    return bytes(out)


FILE_FAULTS = {
    f.name: f
    for f in (
        FileFault('file_truncated', 'the file: this share of it is left', 0.5, '-', _truncated),
        FileFault(
            'file_flipped', 'the file: one bit of so many bytes is flipped', 1.0, '-', _flipped
        ),
    )
}
"""Faults of files by name; they have no time."""


def parse_file(text: str) -> tuple[FileFault, float]:
    """Fault and size of a text as ``file_truncated:0.5``; ConfigError for any other."""
    match = _FORM.fullmatch(text)
    if match is None or match[1] not in FILE_FAULTS:
        raise ConfigError(f'--fault {text}: expected {" or ".join(FILE_FAULTS)}, without a time')
    fault = FILE_FAULTS[match[1]]
    try:
        size = fault.size if match[2] is None else float(match[2])
    except ValueError as error:
        raise ConfigError(f'--fault {text}: {match[2]!r} is not a number') from error
    least, most = (0.0, 1.0) if fault.name == 'file_truncated' else (1.0, 1e6)
    if not least <= size <= most:
        raise ConfigError(f'--fault {text}: {size:g} is outside of [{least:g}, {most:g}]')
    return fault, size


def damage(
    bag: Path, faults: Sequence[tuple[FileFault, float]], target: Path, seed: int
) -> Damaged:
    """Damaged copy of a bag's file, in a folder of its own.

    Raises
    ------
    BagError
        For a bag that is not one file.
    """
    files = [bag] if bag.is_file() else sorted(bag.glob('*.mcap'))
    if len(files) != 1:
        raise BagError(f'{bag}: {len(files)} .mcap files; expected one')
    if target.exists():
        raise WrongRequestError(f'{target} exists already; a bag is never overwritten')
    data = files[0].read_bytes()
    for number, (fault, size) in enumerate(faults):
        data = fault.apply(data, size, np.random.default_rng([seed, number]))
    target.mkdir(parents=True)
    (target / f'{target.name}_0.mcap').write_bytes(data)
    return Damaged(target, tuple(f'{f.name}:{size:g}' for f, size in faults))
