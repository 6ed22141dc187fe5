"""Numbers claimed by the paper of the DVL-less system, for comparison.

Drones 2025, 9(4), 299, section 5: one run. "Could reach 30 m" is said of both coordinates before
the adaptation; velocity errors are largest ones, after it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

MEDIAN, POOLED, MEAN, COUNT = 'median', 'pooled', 'mean', 'count'
"""Ways to pool runs; the last: the number of runs in which it is so."""


@dataclass(frozen=True)
class Quantity:
    """A row of a table."""

    key: str
    title: str
    unit: str
    how: str = MEDIAN


QUANTITIES = (
    Quantity('max_x_before', 'x before, largest error', 'm'),
    Quantity('max_y_before', 'y before, largest error', 'm'),
    Quantity('max_x_after', 'x after, largest error', 'm'),
    Quantity('max_y_after', 'y after, largest error', 'm'),
    Quantity('rms_x_after', 'x after, RMS', 'm', POOLED),
    Quantity('rms_y_after', 'y after, RMS', 'm', POOLED),
    Quantity('max_vx_after', 'v_x after, largest error', 'm/s'),
    Quantity('max_vy_after', 'v_y after, largest error', 'm/s'),
    Quantity('rms_vx_after', 'v_x after, RMS', 'm/s', POOLED),
    Quantity('rms_vy_after', 'v_y after, RMS', 'm/s', POOLED),
    Quantity('worst', 'horizontal error, largest from 30 s on', 'm'),
    Quantity('settle_s', 'below 8 m for a minute, after 750 s', 's'),
    Quantity('nis_after', 'NIS of a fix after (2 is honest)', '', MEAN),
    Quantity('nees_after', 'e²/P of position after (1 is honest)', '', MEAN),
    Quantity('ratio_x', 'fix error over error, x after, largest', ''),
    Quantity('ratio_y', 'fix error over error, y after, largest', ''),
)
IDENTIFIED = (
    Quantity('drag_linear', 'd1x', 'N s/m', MEAN),
    Quantity('drag_quadratic', 'd2x', 'N s²/m²', MEAN),
    Quantity('current_x', 'V_cx', 'm/s', MEAN),
    Quantity('current_y', 'V_cy', 'm/s', MEAN),
    Quantity('current_error', 'error of V_c', 'm/s'),
    Quantity('adapted', 'accepted', '', COUNT),
)
"""At the adaptation of 750 s."""
ALL = (
    *QUANTITIES,
    *IDENTIFIED,
    *(
        Quantity(f'{key}_{window}', f'{title} {window}', unit, how)
        for window in ('before', 'converged')
        for key, title, unit, how in (
            ('rms_x', 'x, RMS', 'm', POOLED),
            ('rms_y', 'y, RMS', 'm', POOLED),
            ('rms_vx', 'v_x, RMS', 'm/s', POOLED),
            ('rms_vy', 'v_y, RMS', 'm/s', POOLED),
            ('nis', 'NIS of a fix', '', MEAN),
            ('nees', 'e²/P of position', '', MEAN),
        )
    ),
    Quantity('max_fix_x_after', 'fixes, x after, largest error', 'm'),
    Quantity('max_fix_y_after', 'fixes, y after, largest error', 'm'),
    Quantity('rms_fix_x_after', 'fixes, x after, RMS', 'm', POOLED),
    Quantity('rms_fix_y_after', 'fixes, y after, RMS', 'm', POOLED),
)
"""All quantities of the CSV file."""

CLAIMED: Mapping[str, float] = {
    'max_x_before': 30.0,
    'max_y_before': 30.0,
    'max_x_after': 3.0,
    'max_y_after': 4.0,
    'max_vx_after': 0.02,
    'max_vy_after': 0.01,
    'ratio_x': 7.0,
    'ratio_y': 7.0,
    'drag_linear': 25.11,
    'drag_quadratic': 18.48,
    'current_x': 0.401,
    'current_y': 0.2466,
    'current_error': 0.0035,
}
"""With the delay compensated. The error of the current is against (0.4, 0.25) m/s, which the text
implies."""
CLAIMED_UNCOMPENSATED: Mapping[str, float] = {'max_x_after': 8.0, 'max_y_after': 8.0}
"""Without: "the error increases to 8 m". The parameters identified then are not in the text."""
