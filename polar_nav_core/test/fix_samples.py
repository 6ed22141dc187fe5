"""Fixes that can be used, for tests of what judges and counts them."""

from dataclasses import replace

import numpy as np

from polar_nav_core.engine.events import Fix

S = 1_000_000_000
PLACE = np.array([-555573.7, 962281.9, 6259444.4])


def fix(number, validity_s, received_s=None, off=0.0, **changes):
    """A fix that can be used, received 1.5 s after it was valid."""
    received_s = validity_s + 1.5 if received_s is None else received_s
    validity_ns, receive_ns = round(validity_s * S), round(received_s * S)
    made = Fix(
        validity_ns, receive_ns - S // 2, receive_ns, 'leader', number, number, 0,
        PLACE + off + number, np.diag([1.0, 2.0, 3.0]),
    )  # fmt: skip
    return replace(made, **changes)
