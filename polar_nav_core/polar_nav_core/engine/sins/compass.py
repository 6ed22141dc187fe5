"""Settings of a measured heading, with the magnetic field around the place of the start."""

from __future__ import annotations

import math

import numpy as np

from ...kernels.sins import compass
from ..events import InitialState
from ..heading_params import LEAST_FIELD, REFERENCES
from ..params import EngineParams

_FOREVER_S = 1e9


def make_heading(p: EngineParams, initial: InitialState | None, stamp_ns: int) -> compass.Heading:
    """Settings of headings for a filter that begins at a place and a stamp [ns].

    Where the field is not known (no place, no date of the model) every magnetic heading is
    refused: the field is zero.
    """
    reference = REFERENCES.index(p.heading_reference) if p.uses_heading else compass.NONE
    noise = np.zeros(compass.NOISE)
    field = np.zeros((compass.FIELD_ROWS, 3))
    near = None
    noise[compass.LEAST_FIELD] = LEAST_FIELD
    if reference == compass.MAGNETIC and initial is not None:
        near = p.field_near(initial.latitude, initial.longitude, initial.height, stamp_ns)
        if near is not None:
            field[compass.PLACE] = near.r_e
            field[compass.FIELD] = near.field_e
            field[compass.GRADIENT :] = near.gradient_e
            horizontal = max(near.horizontal, LEAST_FIELD)
            noise[compass.STATED] = compass.declination_variance(horizontal)
        noise[compass.DECLINATION] = math.radians(p.heading_declination_deg)
    bias, coloured = p.heading_sigmas(near)
    # A reference of its own has any direction: a uniform angle has a sigma of 104 deg.
    noise[compass.START] = bias if reference != compass.ARBITRARY else math.pi / math.sqrt(3.0)
    noise[compass.WHITE] = math.radians(p.heading_sigma_deg) ** 2
    noise[compass.MARKOV_VARIANCE] = coloured**2
    noise[compass.MARKOV_TAU] = p.heading_markov_tau
    noise[compass.TILT] = math.radians(p.heading_tilt_sigma_deg) ** 2
    noise[compass.TURN] = p.heading_turn_factor
    return compass.Heading(
        on=p.uses_heading,
        reference=reference,
        tilts=p.heading_tilts,
        period_ns=round(p.heading_period_s * 1e9),
        noise=noise,
        field=field,
    )


def bias_walk(p: EngineParams, heading: compass.Heading) -> list[float]:
    """Steady variance [rad^2] and correlation time [s] of the bias.

    A reference of its own has no direction that its bias returns to: a walk as fast as others'.
    """
    own = math.radians(p.heading_bias_sigma_deg) ** 2
    if heading.reference == compass.ARBITRARY:
        return [own * _FOREVER_S / p.heading_bias_tau, _FOREVER_S]
    return [float(heading.noise[compass.START]) ** 2, p.heading_bias_tau]
