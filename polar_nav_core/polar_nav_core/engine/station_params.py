"""Parameters of station mode: the station, its acoustics, and the filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .. import earth
from ..arrays import Array
from ..errors import ConfigError
from ..identification.polar_fix import PolarFix
from ..params import NodeParams, choice, param, sigma, vector

FILTERS = ('augmented', 'published')
MEMBERS = 4
"""Densities in the bank."""


@dataclass(frozen=True)
class StationParams(NodeParams):
    """Parameters of the station, of its acoustics and of the filter in station mode."""

    station_latitude_deg: float = param(
        80.0, 'deg', -90.0, 90.0, "Of the station's first position, the origin of its frame"
    )
    station_longitude_deg: float = param(120.0, 'deg', -360.0, 360.0, 'The same')
    station_height: float = param(
        -5.0, 'm', -12000.0, 9000.0, 'The same: height above the ellipsoid'
    )
    station_range_error: float = param(
        0.01, '', 0.0, 0.5, 'Largest error of range per range, uniform; where the fix states none'
    )
    station_bearing_error_deg: float = param(
        1.0, 'deg', 0.0, 90.0, 'Largest error of bearing, uniform; where the fix states none'
    )
    station_range_quantum: float = param(0.5, 'm', 0.0, 100.0, 'Step of the range in its packet')
    station_bearing_quantum_deg: float = param(
        0.5, 'deg', 0.0, 90.0, 'Step of the bearing in its packet'
    )
    station_heading_sigma_deg: float = sigma(
        0.0,
        'deg',
        90.0,
        "1-sigma of the station's heading, the same error in every fix; where the fix states "
        'none. 0: none, and none is estimated',
    )
    station_heading_tau: float = param(3600.0, 's', 1.0, 1e7, 'Its correlation time')
    station_range_scale_sigma: float = sigma(
        0.005,
        '',
        0.5,
        '1-sigma of a scale error that all ranges share: sound speed off by 7.5 m/s',
    )
    station_turn_sigma_deg: float = sigma(
        0.5,
        'deg',
        90.0,
        "1-sigma of the station's array being turned, the same in every fix: mounting and compass",
    )
    station_position_sigma: float = sigma(
        10.0,
        'm',
        1e5,
        "1-sigma per horizontal axis of the station's stated position: GNSS at the surface and a "
        'mooring that leans',
    )
    station_validity: str = choice(
        'packet',
        ('packet', 'travel_time'),
        'When a fix is valid: as its packet says, or 2 D/c + N/v + T before it came (Eq. 11)',
    )
    station_sound_speed: float = param(
        1500.0, 'm/s', 1300.0, 1700.0, 'c of travel_time, where the fix states none'
    )
    station_packet_bits: float = param(192.0, 'bit', 0.0, 1e5, 'N of travel_time')
    station_bit_rate: float = param(9600.0, 'bit/s', 1.0, 1e7, 'v of travel_time')
    station_processing_s: float = param(0.2, 's', 0.0, 60.0, 'T of travel_time')

    station_filter: str = choice(
        'augmented',
        FILTERS,
        'augmented estimates current and drag; published is Eqs. 8-13, which takes them as known',
    )
    station_adaptation: str = choice(
        'auto',
        ('auto', 'always', 'command', 'never'),
        'Which accepted identifications the filter takes: all, those asked for by service, or '
        'none; auto is all in the published filter, those asked for in the augmented one',
    )
    current_method: str = choice(
        'bank',
        ('bank', 'single'),
        "Random walk of the current: four densities weighted by likelihood, or current_walk's",
    )
    current_bank: tuple[float, ...] = vector(
        (1e-8, 1e-6, 1e-5, 1e-4), 'm^2/s^3', 0.0, 1.0, 'Densities q_c of the bank'
    )
    station_forgetting: float = param(
        0.99, '', 0.5, 1.0, "Of the members' log-likelihoods, per fix"
    )
    station_robust_probability: float = param(
        0.99, '', 0.5, 0.9999, 'Share of good fixes that keep their full weight (robust_fixes)'
    )
    model_doubt: float = param(
        10.0,
        '',
        0.0,
        1000.0,
        "Log likelihood ratio from which on fixes that lie to one side of the vehicle's model "
        'loosen it in station mode: the velocity then follows the fixes; 0 is never',
    )
    max_current: float = param(
        3.0,
        'm/s',
        0.0,
        100.0,
        'Strongest current where the vehicle goes; a stronger estimate is an error in station '
        'mode: fixes drift, or the model of the vehicle is wrong; 0: any',
    )
    station_position_noise: float = param(
        2e-3, 'm/sqrt(s)', 0.0, 10.0, 'Random walk of the horizontal position'
    )
    station_depth_noise: float = param(
        0.1,
        'm/sqrt(s)',
        1e-6,
        10.0,
        'Random walk of the vertical position: white noise of the attitude, which must not let '
        'depth observe surge',
    )
    station_attitude_sigma_deg: float = sigma(
        0.66, 'deg', 90.0, "White noise of the AHRS' attitude, per axis"
    )
    station_attitude_smoothing_s: float = param(
        2.0,
        's',
        0.0,
        60.0,
        "Time constant with which rates smooth the AHRS' attitude; 0: taken as it comes (and so "
        'in the published filter)',
    )
    station_heading_bias_sigma_deg: float = param(
        1.7, 'deg', 1e-4, 90.0, "1-sigma of the bias of the AHRS' heading"
    )
    station_heading_bias_walk: float = param(
        3.2e-6, 'rad/sqrt(s)', 0.0, 1.0, 'Random walk of that bias'
    )
    published_fifo: str = choice(
        'kept',
        ('kept', 'shifted'),
        'Whether stored states stay as they were or are shifted by each correction',
    )
    published_noise: tuple[float, ...] = vector(
        (1e-5, 0.2, 1e-4),
        'm^2/s^3, m^2/s, m^2/s',
        0.0,
        1e6,
        'Density of Q: velocity, horizontal position, vertical position',
    )
    published_fix_variance: float = param(100.0, 'm^2', 1e-6, 1e9, 'R of x and y')
    published_current: tuple[float, ...] = vector(
        (0.0, 0.0), 'm/s', -10.0, 10.0, 'Current before the first adaptation'
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.station_range_error == 0.0 and self.station_range_quantum == 0.0:
            raise ConfigError('parameters station_range_error, station_range_quantum: both 0.0')
        if self.station_bearing_error_deg == 0.0 and self.station_bearing_quantum_deg == 0.0:
            raise ConfigError(
                'parameters station_bearing_error_deg, station_bearing_quantum_deg: both 0.0'
            )

    def station_origin_e(self) -> Array:
        """Origin of the station frame, ECEF [m], shape (3,)."""
        return np.asarray(
            earth.ecef_from_geodetic(
                math.radians(self.station_latitude_deg),
                math.radians(self.station_longitude_deg),
                self.station_height,
            )
        )

    def range_variance(self, distance: float) -> float:
        """Variance of a range [m^2]: uniform errors of measurement and packet."""
        error = self.station_range_error * distance
        return error**2 / 3.0 + self.station_range_quantum**2 / 12.0

    def bearing_variance(self) -> float:
        """Variance of a bearing [rad^2]: uniform errors of measurement and packet."""
        error = math.radians(self.station_bearing_error_deg)
        return error**2 / 3.0 + math.radians(self.station_bearing_quantum_deg) ** 2 / 12.0

    def noise_of(self, polar: PolarFix) -> tuple[float, float, float]:
        """Variances of range [m^2] and bearing [rad^2], 1-sigma of the station's heading [rad].

        What the fix leaves open comes from the parameters.
        """
        range_variance, bearing_variance = polar.range_sigma**2, polar.bearing_sigma**2
        heading_sigma = polar.station_heading_sigma
        return (
            range_variance if range_variance > 0.0 else self.range_variance(polar.range),
            bearing_variance if bearing_variance > 0.0 else self.bearing_variance(),
            heading_sigma if heading_sigma > 0.0 else math.radians(self.station_heading_sigma_deg),
        )

    def travel_time(self, distance: float, sound_speed: float) -> float:
        """Time from the transponder's reply to the end of the packet [s] (Eq. 11)."""
        return (
            2.0 * distance / sound_speed
            + self.station_packet_bits / self.station_bit_rate
            + self.station_processing_s
        )
