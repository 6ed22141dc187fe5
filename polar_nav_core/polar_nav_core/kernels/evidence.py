"""What banks of hypotheses about slow faults share: when one begins, the statistic of a pair.

Both modes keep such a bank (`sins.signatures`, `station.signatures`); its hypotheses stand in
slots by their beginnings. Derivation: docs/derivations/signatures.md.
"""

from __future__ import annotations

import math

from ..arrays import Array, Ints
from .cache import kernel


@kernel
def slot_to_begin(
    born_ns: Ints, now_ns: int, oldest_ns: int, statistic: Array, most: float
) -> int:
    """Slot for hypotheses that begin now: an empty one, or one that is hardly missed.

    Ages stay about a factor of two apart so, but for the beginning that has most evidence: a
    younger or older one in its place would have to gather it again.

    Parameters
    ----------
    born_ns : (slots,) array of int
        When the hypotheses of each slot began [ns]; 0 for an empty slot.
    now_ns : int
    oldest_ns : int
        An age beyond which a slot is the first to make room [ns].
    statistic : (slots * kinds,) array
        Of each hypothesis, slot by slot.
    most : float
        Statistic from which on the likeliest beginning does not make room.
    """
    chosen = -1
    least = math.inf
    kinds = statistic.shape[0] // born_ns.shape[0]
    kept = -1
    for i in range(statistic.shape[0]):
        if statistic[i] > most:
            kept, most = i // kinds, statistic[i]
    for slot in range(born_ns.shape[0]):
        if born_ns[slot] == 0:
            return slot
        # Ratio of the ages of its neighbours; the newest and the oldest have one only.
        older_ns, younger_ns = 0, now_ns
        for other in range(born_ns.shape[0]):
            other_ns = born_ns[other]
            if other_ns < born_ns[slot]:
                older_ns = max(older_ns, other_ns)
            elif other_ns > born_ns[slot]:
                younger_ns = min(younger_ns, other_ns)
        ratio = math.inf
        if older_ns > 0 and younger_ns < now_ns:
            ratio = (now_ns - older_ns) / (now_ns - younger_ns)
        elif older_ns == 0 and now_ns - born_ns[slot] > oldest_ns:
            ratio = 0.0
        if ratio < least and (slot != kept or ratio == 0.0):
            chosen, least = slot, ratio
    return chosen


@kernel
def pair_statistic(l_i: float, l_j: float, l_x: float, z_i: float, z_j: float) -> float:
    """Twice the log likelihood ratio of two sizes that fit best together, against none.

    Parameters
    ----------
    l_i, l_j, l_x : float
        Lambda of each, and between both.
    z_i, z_j : float
        zeta of each.
    """
    det = l_i * l_j - l_x * l_x
    both = 0.0
    if det > 1e-6 * l_i * l_j:
        both = (z_i * z_i * l_j - 2.0 * z_i * z_j * l_x + z_j * z_j * l_i) / det
    return both
