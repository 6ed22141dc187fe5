"""The frozen matrix: hashes of estimates and receipts of many runs, which no change may alter.

    python tests/frozen_matrix.py            # compare; names each row that differs, and in what
    python tests/frozen_matrix.py --renew    # the same, then write the rows anew

Bits depend on the processor, numba and numpy, which stand in the file. Where those are others, and
only there, runs are compared with the numbers that stand beside the hashes: to 1e-6 of sigma
(those in `AMPLIFIES` to more), with the same verdicts. ``frozen_runs.py`` has the runs,
``test_frozen_matrix.py`` the tests.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from frozen_runs import WORLDS, Run, cpu_key, run, variants_of

FILE = Path(__file__).with_name('frozen_matrix.json')
DIGITS = 16
"""Of each sha256, that are kept."""
LIMIT_SIGMA = 1e-6
AMPLIFIES = {
    'station / back_propagate': 1e-3,
    'bag reference / modified_akf_published': 1e-4,
    'bag station / published': 1e-4,
    'station odd / published': 1e-4,
    'unusable / modified_akf_published': 1e-4,
    'unusable / ignore sage_husa_published': 1e-4,
}
"""Limits of runs that amplify rounding, by the beginning of their names [sigma].

Measured with kernels compiled for a processor without AVX and FMA (``NUMBA_CPU_NAME=generic``):
the inverse of the transition of a model with drag grows with the age of a fix, and the noise
filters as printed lose their conditioning. Largest: 2.8e-4 and 6.1e-6 sigma. 'station odd /
published' keeps its bits there; it amplifies the rounding of NumPy's matrix products. With those
for other processors (``OPENBLAS_CORETYPE``: Prescott, Nehalem, Sandybridge, Haswell, Zen) it is up
to 2.7e-5 sigma apart (Nehalem): 1e-4 is 3.6 times that, as the first limit is of its own.
On a Zen 3 processor (rows of a Zen 4) 'unusable / ignore sage_husa_published mahalanobis' is
3.4e-5 sigma apart, all other rows keep their limits.
"""


def row_of(found: Run) -> dict[str, Any]:
    """Return a row of the matrix: hashes, verdicts, and the estimates half-way and at the end."""
    hashes = {}
    for part, value in found.parts.items():
        digest = hashlib.sha256()
        _add(digest, value)
        hashes[part] = digest.hexdigest()[:DIGITS]
    n = len(found.stamps_ns)
    return {
        'sha256': hashes,
        'count': n,
        'verdicts': dict(sorted(found.verdicts.items())),
        'at': [_numbers(found, k) for k in sorted({n // 2, n - 1}) if 0 <= k < n],
    }


def _numbers(found: Run, k: int) -> list[Any]:
    """Stamp, r_e, v_G, sigma of both: all digits of an estimate, nine of its sigma."""
    sigma = [float(f'{s:.9g}') for s in (*found.sigma_r[k], *found.sigma_v[k])]
    return [int(found.stamps_ns[k]), found.r_e[k].tolist(), found.v_G[k].tolist(), sigma]


def _add(digest: Any, value: Any) -> None:
    """Add a value to a hash, with names and shapes; a NaN is a NaN, whatever its sign."""
    if isinstance(value, bytes):
        digest.update(value)
    elif isinstance(value, Mapping):
        for name, item in value.items():
            digest.update(f'{name}:'.encode())
            _add(digest, item)
    elif isinstance(value, np.ndarray):
        if value.dtype.kind == 'f':
            value = np.where(np.isnan(value), np.nan, value)
        digest.update(f'{value.dtype.str}{value.shape}'.encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, list | tuple):
        digest.update(f'[{len(value)}'.encode())
        for item in value:
            _add(digest, item)
    elif isinstance(value, Enum):
        digest.update(f'{value.name};'.encode())
    else:  # numbers with all digits
        digest.update(f'{value!r};'.encode())


def differences(
    expected: Mapping[str, Any],
    found: Mapping[str, Any],
    *,
    bits: bool,
    limit: float = LIMIT_SIGMA,
) -> list[str]:
    """Return in what two rows differ, as sentences; none where they are equal.

    Parameters
    ----------
    expected, found : mapping
        Rows of `row_of`.
    bits : bool
        Compare hashes; else numbers.
    limit : float
        To which numbers are compared [sigma].
    """
    if bits:
        a, b = expected['sha256'], found['sha256']
        parts = [part for part in (*a, *(b.keys() - a)) if a.get(part) != b.get(part)]
        if not parts:
            return []
        out = [f'bits of {", ".join(parts)}']
        near = differences(expected, found, bits=False, limit=limit)
        return out + (near or [f'within {limit:g} sigma half-way and at the end'])
    out = [
        f'{what}: {expected[what]} before, now {found[what]}'
        for what in ('count', 'verdicts')
        if expected[what] != found[what]
    ]
    for before, now in zip(expected['at'], found['at'], strict=False):
        sigmas = _sigmas_apart(before, now)
        if not sigmas <= limit:
            out.append(f'{sigmas:.1e} sigma apart at {before[0]} ns')
    return out


def _sigmas_apart(before: list[Any], now: list[Any]) -> float:
    """Largest difference in units of the smallest sigma; of sigma in units of itself."""
    if before[0] != now[0]:
        return float('inf')
    sigma = np.array(before[3])
    apart = [_largest(np.subtract(now[3], sigma) / sigma, sigma, now[3])]
    for k in (1, 2):
        unit = sigma[3 * k - 3 : 3 * k].min()
        apart.append(_largest(np.subtract(now[k], before[k]) / unit, before[k], now[k]))
    return max(apart)


def _largest(ratio: Any, before: Any, now: Any) -> float:
    """Largest size; none where neither has a number, inf where one has."""
    none = np.isnan(before) & np.isnan(now)
    return float(np.max(np.where(none, 0.0, np.nan_to_num(np.abs(ratio), nan=np.inf))))


def rows_of(world: str, variants: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Run some variants in a world, by arrays where that can be: rows by ``world / variant``."""
    return {f'{world} / {variant}': row_of(run(world, variant)) for variant in variants}


def drivers_apart(world: str, variants: Iterable[str]) -> list[str]:
    """Return the rows in which the two drivers of whole runs differ by a bit."""
    return [
        f'{world} / {variant}'
        for variant in variants
        if str(row_of(run(world, variant)))  # NaN as NaN
        != str(row_of(run(world, variant, one_by_one=True)))
    ]


def read() -> dict[str, Any]:
    """Read the frozen matrix: ``machine`` and ``rows``."""
    return dict(json.loads(FILE.read_text(encoding='utf-8')))


def write(rows: Mapping[str, Any]) -> None:
    """Write the matrix, one row a line."""
    lines = ',\n'.join(f'{json.dumps(name)}: {json.dumps(row)}' for name, row in rows.items())
    text = f'{{"machine": {json.dumps(cpu_key())},\n"rows": {{\n{lines}\n}}}}\n'
    FILE.write_text(text, encoding='utf-8')


def compare(rows: Mapping[str, Any], *, whole: bool = False) -> list[str]:
    """Return what differs from the frozen matrix: ``row: sentence``.

    Parameters
    ----------
    rows : mapping
        Rows as found.
    whole : bool
        They are all rows: one that is frozen and was not found differs, too.
    """
    frozen = read()
    bits = frozen['machine'] == cpu_key()
    out = []
    for name, row in rows.items():
        if name not in frozen['rows']:
            out.append(f'{name}: not in {FILE.name}')
            continue
        limit = next((v for k, v in AMPLIFIES.items() if name.startswith(k)), LIMIT_SIGMA)
        found = differences(frozen['rows'][name], row, bits=bits, limit=limit)
        out += [f'{name}: {"; ".join(found)}'] if found else []
    if whole:
        out += [f'{name}: not found' for name in frozen['rows'].keys() - rows.keys()]
    return out


def main() -> int:
    """Compare the whole matrix, and renew it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--renew', action='store_true', help='write the rows as they are now')
    renew = parser.parse_args().renew
    rows: dict[str, Any] = {}
    for world in WORLDS:
        rows |= rows_of(world, variants_of(world))
    differs = compare(rows, whole=True) if FILE.exists() else ['there was no matrix']
    sys.stdout.writelines(f'{line}\n' for line in differs)
    sys.stdout.write(f'{len(rows)} rows, {len(differs)} differ\n')
    if renew:
        write(rows)
    return 1 if differs and not renew else 0


if __name__ == '__main__':
    sys.exit(main())
