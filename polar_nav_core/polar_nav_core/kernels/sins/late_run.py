"""Late fixes of a run, fused exactly where they were received: the compiled loop of `clone`."""

from __future__ import annotations

from ...arrays import Array
from ..cache import apart, entry, routine
from . import state as fs
from .blocks import Blocks
from .bridge import reach
from .consider import fix_common
from .events import note_outcome
from .fuse import locate
from .late import fill_stored_fix, newest_until
from .late_fuse import OUT_OF_REACH, fuse_late, settle
from .late_place import find_block
from .measured import consider_leader
from .output import Rows
from .rings import Log, Past, Streams
from .rows import DV
from .run import put_row, run_until
from .settings import Settings
from .state import Frames, State
from .update import Ints
from .work import Work


@entry
@routine
def take_late(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    bl: Blocks,
    validity_ns: int,
    r_e: Array,
    covariance_e: Array,
    array_heading: float,
    relative_e: Array,
    common_e: Array,
    note: Ints,
) -> int:
    """Fuse one late fix; FUSED, REFUSED, S_NOT_DEFINITE or OUT_OF_REACH.

    The innovation is that of the position stored before the validity plus velocity times the rest.
    Axes and USBL bias are those stored, too; the rows have the velocity, so that what is learnt of
    it later moves the innovation.

    ``note`` (3,), whole numbers: its first becomes the covariance steps since the validity.
    """
    code: int = fuse_stored_fix(
        s,
        fr,
        c,
        past,
        w,
        log,
        bl,
        validity_ns,
        r_e,
        covariance_e,
        array_heading,
        relative_e,
        common_e,
        note,
    )
    return code


@apart
@routine
def fuse_stored_fix(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    bl: Blocks,
    validity_ns: int,
    r_e: Array,
    covariance_e: Array,
    array_heading: float,
    relative_e: Array,
    common_e: Array,
    note: Ints,
) -> int:
    """`take_late`, for kernels: those that call it are compiled beside it and not after it."""
    number = newest_until(past.stamps, s.counters[fs.EPOCHS], validity_ns)
    if number < 0 or validity_ns < s.counters[fs.FROM_NS]:
        return OUT_OF_REACH
    i = number % past.stamps.shape[0]
    note[0] = s.counters[fs.STEPS] - past.steps[i]
    if (
        note[0] >= past.transitions.shape[0]
        or s.counters[fs.CORRECTIONS] - past.firsts[i] > past.corrections.shape[0]
    ):
        return OUT_OF_REACH
    place, block = find_block(s, past, log, bl, validity_ns)
    if place < 0:
        return OUT_OF_REACH
    if not settle(s, past, log, bl, block):
        return fs.S_NOT_DEFINITE
    ahead = fill_stored_fix(
        c, past, w, i, validity_ns, r_e, covariance_e, array_heading, common_e, w.C_mean, w.C_mean
    )
    for k in range(3):
        w.H[k, DV + k] = ahead
    consider_leader(s, c, common_e)
    if s.counters[fs.CONSIDERS] == 1:
        fix_common(w.J, fr.C_e_G, relative_e, s.v_G, common_e)
    code: int = fuse_late(s, c, past, w, log, bl, validity_ns, number, place, block)
    locate(s, fr, c)
    return code


@entry
@routine
def advance_late(
    s: State,
    fr: Frames,
    c: Settings,
    past: Past,
    w: Work,
    log: Log,
    bl: Blocks,
    streams: Streams,
    until_ns: int,
    until_rank: int,
    rows: Rows,
) -> int:
    """Process as `run.advance` does, with the fixes of the streams fused as late ones.

    Returns
    -------
    int
        As `advance`: STOPPED after a fix that the gate refused, and before one out of reach.
    """
    while True:
        f = s.counters[fs.FIX]
        k = f % streams.fix_stamps.shape[0]
        stamp = streams.fix_stamps[k]
        if f >= streams.counts[3] or stamp > until_ns:
            break
        if stamp == until_ns and until_rank <= fs.FIX_RANK:
            break
        code = run_until(s, fr, c, past, w, log, streams, stamp, fs.FIX_RANK, rows)
        if code != fs.DONE:
            return code
        if 0 <= rows.io[0] < stamp:
            if rows.io[1] >= rows.stamps.shape[0]:
                return fs.FULL
            put_row(s, c, rows)
        reach(s, fr, c, past, w, log, stamp)
        note = streams.fix_notes[k]
        w.dof[0] = streams.fix_dof[k]
        code = fuse_stored_fix(
            s,
            fr,
            c,
            past,
            w,
            log,
            bl,
            streams.fix_validities[k],
            streams.fix_r_e[k],
            streams.fix_covariance_e[k],
            streams.fix_array_heading[k],
            streams.fix_relative_e[k],
            streams.fix_common_e[k],
            note,
        )
        if code == OUT_OF_REACH:
            return fs.STOPPED
        s.counters[fs.FIX] += 1
        note[1] = s.counters[fs.STAMP]
        note[2] = rows.io[1]
        note_outcome(s, w, code, streams.fix_outcomes[k])
        if code == fs.REFUSED:
            return fs.STOPPED
        if code < 0:
            return code
    return run_until(s, fr, c, past, w, log, streams, until_ns, until_rank, rows)
