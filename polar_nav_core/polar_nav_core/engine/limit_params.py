"""Limits of samples and streams: a sample beyond them is refused, a longer pause is a gap."""

from __future__ import annotations

from dataclasses import dataclass

from ..params import NodeParams, choice, param, sigma


@dataclass(frozen=True)
class LimitParams(NodeParams):
    """Limits of the vehicle, of its sensors and of their stamps."""

    max_speed: float = param(
        20.0,
        'm/s',
        0.1,
        1e4,
        'Fastest that the vehicle can be; beyond is an error, and a DVL velocity per axis refused',
    )
    max_depth: float = param(
        12000.0,
        'm',
        1.0,
        12000.0,
        'Deepest that the vehicle can be; beyond is an error, and a depth refused',
    )
    max_rate: float = param(
        6.0,
        'rad/s',
        0.1,
        1e300,
        'Largest rate per axis of an IMU sample that is used: about the range of small gyroscopes '
        '(350 deg/s)',
    )
    max_specific_force: float = param(
        60.0,
        'm/s^2',
        11.0,
        1e300,
        'Largest specific force per axis of an IMU sample that is used: 6 g, above the slam of a '
        'vehicle at the surface',
    )
    max_fix_sigma: float = param(
        10.0,
        '',
        0.0,
        1e6,
        'Without a gate (gate_probability 1.0): a fix beyond this many sigma, and farther off '
        'than max_speed since the fix before, is refused; 0 for none',
    )
    min_fix_sigma: float = param(
        0.1,
        'm',
        0.0,
        100.0,
        'Of the best acoustic fix, in any horizontal direction (the constant part of a ship class '
        'USBL): one that states less is used with this, an antenna with 0.01 at most (mode sins); '
        '0: as stated, as a camera in a tank needs it, and engines up to 17 had it',
    )
    max_imu_noise_factor: float = param(
        1.0,
        '',
        1.0,
        1e6,
        'Pings or depths that agree and are refused in a row, while no position fix vouches '
        'against them, raise the noise of the IMU (rates and forces) up to so many times the '
        'stated one; 1 is never, and so is reopen_after_s 0. `polar map` writes 1000 for MEMS',
    )
    imu_gap_s: float = param(
        0.1,
        's',
        0.0,
        60.0,
        'A gap between IMU samples longer than this, and than three of their intervals, is '
        'bridged by the last rates and velocity, with the covariance enlarged; 0 is never',
    )
    imu_missing: str = choice(
        'interpolated',
        ('interpolated', 'held'),
        'Samples missing from a regular IMU, up to a gap that is bridged: interpolated, with the '
        'variance of that, or the next sample held over their time (up to engine 7)',
    )
    gap_attitude_sigma_deg: float = sigma(
        5.7,
        'deg',
        90.0,
        '1-sigma per axis by which the attitude is lost in a gap of 1 s (0.1 rad/s, about the '
        'roll, pitch and turns of a small vehicle); shorter gaps: with the square of the time',
    )
    gap_velocity_sigma: float = sigma(
        0.5,
        'm/s',
        100.0,
        '1-sigma per axis by which the velocity is lost in a gap of 1 s; shorter ones: with the '
        'time',
    )
    max_stamp_leap_s: float = param(
        0.25,
        's',
        0.01,
        86400.0,
        'An IMU sample whose stamp is further ahead of the one before waits for a second one that '
        'agrees (other sensors: 10 s ahead of their topic and of the IMU)',
    )
    sensor_silent_s: float = param(
        30.0,
        's',
        0.1,
        86400.0,
        'A DVL or depth sensor that was used, and of which nothing is for longer, is a warning',
    )
    max_imu_repeats: int = param(
        5,
        '',
        0,
        1_000_000,
        'An IMU sample with the rates and forces of more than so many before it, bit for bit, is '
        'refused: the sensor hangs (mode sins); 0 is never',
    )
    max_instrument_repeats: int = param(
        5,
        '',
        0,
        1_000_000,
        'An IMU sample with the rates of more than so many before it, or with their forces, is '
        'refused where no axis repeated itself so often in the 300 samples before that: the '
        'gyros hang, or the accelerometers do (mode sins); 0 is never',
    )
    max_rate_leap: float = param(
        0.5,
        'rad/s',
        0.01,
        1e300,
        'An IMU sample whose rate is further off the one before per axis than this, and than 20 '
        'rad/s^2 in between, is refused unless the next one agrees (mode sins)',
    )
    imu_shock: float = param(
        10.0,
        '',
        0.0,
        1e6,
        'An IMU sample that differs from the one before by more than so many times the usual '
        'change, and by 0.1 rad/s (and 3 rad/s^2) or 3 m/s^2 (and 20 m/s^3), is half believed: '
        'attitude and velocity become as uncertain as it may be off (mode sins); 0 is never',
    )
    max_imu_gap_s: float = param(
        0.5, 's', 0.01, 60.0, 'A longer gap between IMU samples is an error for a minute'
    )
