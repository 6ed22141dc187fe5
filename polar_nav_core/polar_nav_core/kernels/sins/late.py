"""Rows of a late fix: against the position stored at its validity, referred to now.

Derivation: docs/derivations/late_fixes.md.
"""

from __future__ import annotations

from ...arrays import Array
from ..cache import entry, kernel, routine
from . import state as fs
from .measured import fill_shared, place_of_epoch
from .rings import Past
from .rows import fix_rows
from .settings import Settings
from .state import Frames, State
from .update import Ints
from .walk import walk_forward
from .work import Work

OUT_OF_REACH = -1


@entry
@kernel
def newest_until(stamps: Ints, count: int, stamp_ns: int) -> int:
    """Number of the newest of ``count`` stamps in a ring that is not after ``stamp_ns``.

    -1 when no stored one is. Number i stands at i % length; stamps [ns] do not fall.
    """
    length = stamps.shape[0]
    low = max(0, count - length)
    if count == 0 or stamps[low % length] > stamp_ns:
        return -1
    high = count - 1
    while low < high:
        middle = (low + high + 1) // 2
        if stamps[middle % length] <= stamp_ns:
            low = middle
        else:
            high = middle - 1
    found: int = low
    return found


@kernel
def fill_stored_fix(
    c: Settings,
    past: Past,
    w: Work,
    i: int,
    validity_ns: int,
    r_e: Array,
    covariance_e: Array,
    array_heading: float,
    common_e: Array,
    epoch_C_e_G: Array,
    C_e_G: Array,
) -> float:
    """Fill w with H, R, z of a fix at a stored epoch; returns the time to its validity [s].

    Parameters
    ----------
    c, past, w : Settings, Past, Work
        H, R and z of the scratch are filled; point_e, velocity_e and C_a_G are scratch.
    i : int
        Slot of the epoch in the stored past.
    validity_ns, r_e, covariance_e, array_heading, common_e
        Of the fix, as for `fill_late_fix`.
    epoch_C_e_G : (3, 3) in place
        Grid axes stored in the epoch.
    C_e_G : (3, 3)
        Grid axes of the rows.
    """
    place_of_epoch(past, i, w.point_e, w.velocity_e, epoch_C_e_G)
    ahead: float = (validity_ns - past.stamps[i]) * 1e-9
    for k in range(3):
        w.point_e[k] += w.velocity_e[k] * ahead
    fill_shared(w.C_a_G, c, C_e_G, array_heading, common_e)
    lever_G, bias_a = past.levers[i], past.usbl_biases[i]
    fix_rows(w.H, w.R, w.z, C_e_G, lever_G, w.point_e, r_e, covariance_e, w.C_a_G, bias_a)
    return ahead


@entry
@routine
def fill_late_fix(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    validity_ns: int,
    r_e: Array,
    covariance_e: Array,
    array_heading: float,
    common_e: Array,
) -> int:
    """Fill the scratch with H Phi^-1, R and z of a late fix; returns its age in filter steps.

    The innovation is that of the position stored before the time of validity plus velocity times
    the rest; the frames are those of now.

    Parameters
    ----------
    s, fr, c, past : the present, and the stored past
    w : Work
        H, R, z are filled; point_e, velocity_e, C_e_G and C_a_G are scratch.
    validity_ns : int
        When the fix is valid [ns].
    r_e, covariance_e : (3,), (3, 3) arrays
        The fix and its covariance, ECEF [m], [m^2].
    array_heading : float
        Of the leader's USBL array, clockwise from its grid north [rad].
    common_e : (3, 7) array
        Change of the fix per unit of each of the leader's errors, ECEF [m].

    Returns
    -------
    int
        Covariance steps since then; OUT_OF_REACH when not all of them are stored any more.
    """
    number = newest_until(past.stamps, s.counters[fs.EPOCHS], validity_ns)
    if number < 0 or validity_ns < s.counters[fs.FROM_NS]:
        return OUT_OF_REACH
    i = number % past.stamps.shape[0]
    step = past.steps[i]
    correction = past.firsts[i]
    if (
        s.counters[fs.STEPS] - step >= past.transitions.shape[0]
        or s.counters[fs.CORRECTIONS] - correction > past.corrections.shape[0]
    ):
        return OUT_OF_REACH
    w.age[0] = (s.counters[fs.STAMP] - validity_ns) * 1e-9
    fill_stored_fix(
        c,
        past,
        w,
        i,
        validity_ns,
        r_e,
        covariance_e,
        array_heading,
        common_e,
        w.C_e_G,
        fr.C_e_G,
    )
    walk_forward(
        w.H,
        w.z,
        3,
        past.inverses,
        step,
        s.counters[fs.STEPS],
        past.corrections,
        past.correction_steps,
        correction,
        s.counters[fs.CORRECTIONS],
    )
    steps: int = s.counters[fs.STEPS] - step
    return steps
