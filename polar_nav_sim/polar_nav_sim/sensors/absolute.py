"""Absolute positions: GNSS at the surface, a beacon under the ice, an acoustic positioning system.

True position of a point of the vehicle with white noise of stated sigmas, every ``period_s``
within windows of time.
"""

from __future__ import annotations

from dataclasses import dataclass

from polar_nav_core.params import param, vector

from ..section import Spec


@dataclass(frozen=True)
class AbsoluteErrors(Spec):
    """Errors of absolute positions, and when there are any."""

    period_s: float = param(10.0, 's', 0.1, 3600.0, 'Between fixes')
    horizontal_sigma_m: float = param(2.0, 'm', 0.0, 1e4, '1-sigma per horizontal axis')
    vertical_sigma_m: float = param(4.0, 'm', 0.0, 1e4, '1-sigma of height')
    lever_b: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -100.0, 100.0, 'Located point, from base_link, body axes'
    )
    first_s: float = param(0.0, 's', 0.0, 1e6, 'Start of the first window of availability')
    available_s: float = param(60.0, 's', 0.1, 1e6, 'Length of a window')
    repeat_s: float = param(0.0, 's', 0.0, 1e6, 'From window to window; 0: there is only one')
