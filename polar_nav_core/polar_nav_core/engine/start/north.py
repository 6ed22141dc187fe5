"""Direction that measured headings count from at a place, for a start.

What the filter does by its kernels (`kernels.sins.compass`), before there is a filter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...earth import SEMI_MAJOR
from ...grid import convergence, ecef_to_grid
from ..events import HeadingSample
from ..heading_params import LEAST_FIELD
from ..params import EngineParams


class North(NamedTuple):
    """Reference of headings at a place.

    Attributes
    ----------
    azimuth : float
        Its direction, clockwise from grid north, less what the driver has added to headings [rad].
    sigma : float
        1-sigma of a heading with it, but for scatter: slow errors of headings and place [rad].
    name : str
        For sentences.
    refusal : str
        Sentence on why headings from it start nothing; empty if they can.
    """

    azimuth: float
    sigma: float
    name: str
    refusal: str = ''


def north_of(
    p: EngineParams,
    latitude: float,
    longitude: float,
    height: float,
    sigma_position: float,
    stamp_ns: int,
) -> North:
    """Reference of measured headings at a place.

    Parameters
    ----------
    p : EngineParams
    latitude, longitude, height : float
        [rad, rad, m]
    sigma_position : float
        1-sigma of the place, per horizontal axis [m].
    stamp_ns : int
        Present [ns]: the magnetic field changes with the years.
    """
    reference = p.heading_reference
    name = f'{reference} north'
    sigma = math.hypot(*p.heading_sigmas(None))
    if reference == 'arbitrary':
        source = HeadingSample.topic
        return North(0.0, math.inf, name, f'{source} counts from a direction of its own')
    if reference == 'true':
        turned = convergence_sigma(latitude, sigma_position)
        azimuth = -float(convergence(latitude, longitude))
        return North(azimuth, math.hypot(sigma, turned), name)
    if reference != 'magnetic':
        return North(0.0, sigma, name)
    field = p.field_near(latitude, longitude, height, stamp_ns)
    if field is None:
        return North(
            0.0,
            math.inf,
            name,
            'the magnetic field is not known: no model is of the date, see magnetic_year',
        )
    east, north, _ = (float(b) for b in ecef_to_grid(field.r_e) @ field.field_e)
    refusal = ''
    if field.horizontal < LEAST_FIELD:
        refusal = f'the horizontal magnetic field is {field.horizontal:.0f} nT here: too weak'
    azimuth = math.atan2(east, north) - math.radians(p.heading_declination_deg)
    return North(azimuth, math.hypot(*p.heading_sigmas(field)), name, refusal)


def convergence_sigma(latitude: float, sigma_position: float) -> float:
    """1-sigma of true north against grid north [rad] from the error of the place [m]."""
    distance = SEMI_MAJOR * math.cos(latitude)
    return sigma_position / distance if distance > 0.0 else math.inf
