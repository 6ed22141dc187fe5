"""Innovations of a run as independent numbers, errors that they have in common taken out.

Whitened innovations are w = nu + W b: nu independent with unit variance, b the common errors
(`consider`) with b ~ N(0, diag(sigma^2)). Row by row a filter of its own estimates b; what is left
of each row after what the rows before say of b is independent again. The likelihood of a run is
that of these numbers. Derivation: docs/derivations/tuning.md.
"""

from __future__ import annotations

import math

from ...arrays import Array, Ints
from ..cache import entry, routine


@entry
@routine
def independent_rows(
    white: Array,
    moved: Array,
    sizes: Ints,
    sigma: Array,
    b: Array,
    P: Array,
    g: Array,
    out: Array,
    log_sigma: Array,
) -> None:
    """Whiten innovations once more, with the common errors unknown.

    Parameters
    ----------
    white, moved, sizes : (n, 3), (n, 3, c), (n,) arrays
        As of `engine.innovations.Innovations`.
    sigma : (c,) array
        Stated sigmas of the common errors.
    b, P, g : (c,), (c, c), (c,) scratch
    out : (n, 3) array, out
        Independent numbers of unit variance; zero beyond a measurement's size.
    log_sigma : (n, 3) array, out
        Logarithm of the sigma of each row, in units of that without common errors.
    """
    c = sigma.shape[0]
    for i in range(c):
        b[i] = 0.0
        for j in range(c):
            P[i, j] = 0.0
        P[i, i] = sigma[i] * sigma[i]
    for k in range(white.shape[0]):
        for a in range(3):
            out[k, a] = log_sigma[k, a] = 0.0
            if a >= sizes[k]:
                continue
            z, s = white[k, a], 1.0
            for i in range(c):
                g[i] = 0.0
                for j in range(c):
                    g[i] += P[i, j] * moved[k, a, j]
            for i in range(c):
                s += moved[k, a, i] * g[i]
                z -= moved[k, a, i] * b[i]
            out[k, a] = z / math.sqrt(s)
            log_sigma[k, a] = 0.5 * math.log(s)
            for i in range(c):
                b[i] += g[i] * z / s
                for j in range(c):
                    P[i, j] -= g[i] * g[j] / s
