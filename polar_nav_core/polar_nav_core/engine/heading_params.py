"""Parameters of a measured heading: what it counts from, and its errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .. import magnetic
from ..kernels.sins import compass
from ..params import NodeParams, choice, flag, param, sigma

REFERENCES = ('none', 'true', 'magnetic', 'grid', 'arbitrary')
"""What a heading counts from; kernels know them by index (kernels.sins.compass)."""
LEAST_FIELD = 2000.0
"""Horizontal field below which a magnetic heading is refused [nT]: WMM's blackout zone."""


@dataclass(frozen=True)
class HeadingParams(NodeParams):
    """Heading of an AHRS, gyrocompass or magnetic compass, mode sins."""

    heading_reference: str = choice(
        'none',
        REFERENCES,
        'What measured headings count from; arbitrary: a direction of their own; none: headings '
        'are not used. They take the place of the error of the leader (leader_error_tau)',
    )
    heading_declination_deg: float = param(
        0.0,
        'deg',
        -180.0,
        180.0,
        'Declination that the driver of a magnetic compass has added to its headings already',
    )
    heading_sigma_deg: float = param(0.5, 'deg', 1e-3, 90.0, 'White noise of a measured heading')
    heading_bias_sigma_deg: float = param(
        4.5,
        'deg',
        1e-3,
        180.0,
        '1-sigma of its slow bias (mounting, deviation), which is estimated; the uncertainty of '
        'the declination comes on top',
    )
    heading_bias_tau: float = param(3600.0, 's', 10.0, 1e6, 'Correlation time of the bias')
    heading_markov_sigma_deg: float = param(
        2.0,
        'deg',
        1e-3,
        90.0,
        '1-sigma of the coloured error of a measured heading: soft iron on changing courses, the '
        "AHRS' own filter",
    )
    heading_markov_tau: float = param(60.0, 's', 0.1, 1e5, 'Its correlation time')
    heading_tilt_sigma_deg: float = param(
        1.0,
        'deg',
        1e-3,
        90.0,
        "1-sigma of the AHRS' roll and pitch, coloured as the heading; times the tangent of the "
        'dip it is in a magnetic heading',
    )
    heading_tilts: bool = flag(
        False,
        "Whether the AHRS' roll and pitch are measurements, too: for a gyro too poor to navigate",
    )
    heading_turn_factor: float = sigma(
        1.0,
        '',
        100.0,
        "Error of the AHRS' vertical per v x yaw rate / g in a turn; 0: the AHRS corrects that",
    )
    heading_period_s: float = param(
        1.0, 's', 1e-3, 3600.0, 'At most one heading is used in this time: they are coloured'
    )
    magnetic_year: float = param(
        0.0,
        'year',
        0.0,
        2030.0,
        'Year and fraction for which the magnetic field is computed; 0: that of the stamps',
    )

    def field_near(
        self, latitude: float, longitude: float, height: float, stamp_ns: int
    ) -> magnetic.Field | None:
        """Magnetic field around a place [rad, rad, m] at a stamp [ns]; None without a model."""
        year = self.magnetic_year or magnetic.year_of(stamp_ns)
        return magnetic.field_near(latitude, longitude, height, year)

    def heading_sigmas(self, field: magnetic.Field | None) -> tuple[float, float]:
        """1-sigma of the bias of headings, and of their coloured error [rad].

        Parameters
        ----------
        field : Field or None
            That a magnetic heading counts from: its declination adds to the bias, and a tilt of
            the AHRS times its dip to the coloured error.
        """
        bias = math.radians(self.heading_bias_sigma_deg)
        coloured = math.radians(self.heading_markov_sigma_deg)
        if field is None:
            return bias, coloured
        horizontal = max(field.horizontal, LEAST_FIELD)
        tilt = math.radians(self.heading_tilt_sigma_deg) * abs(field.vertical) / horizontal
        declination = compass.declination_variance(horizontal)
        return math.sqrt(bias**2 + declination), math.hypot(coloured, tilt)
