"""Default values of parameters at each engine version, to replay recordings that omit them.

A follower states all its parameters on ``/run_info``, so a recording lacks those only that were
declared after it. They must not take today's default: the recorded run did what the engine of its
time did. A test holds the newest column of this table equal to the defaults in the code, so that
neither a new parameter nor another default comes without an entry here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_FIRST: dict[str, Any] = {
    'accel_bias_sigma': 9.80665e-06,
    'accel_bias_walk': 0.0,
    'accel_noise_density': 3.101e-07,
    'adaptive_ceiling': 1e300,
    'adaptive_floor': 0.5,
    'align_heading': 'auto',
    'align_window_s': 10.0,
    'autostart': True,
    'base_frame': '',
    'bottom_lock_pings': 3,
    'bottom_lock_timeout_s': 1.5,
    'configuration': 'modified_akf',
    'current_bank': (1e-08, 1e-06, 1e-05, 0.0001),
    'current_method': 'bank',
    'current_sigma': 0.4,
    'current_walk': 1e-05,
    'delay_handling': 'back_propagate',
    'depth_lever_b': (0.0, 0.0, 0.0),
    'depth_offset_sigma': 0.0,
    'depth_sigma': 0.05,
    'dvl_latency_sigma': 0.0,
    'dvl_lever_b': (0.0, 0.0, 0.0),
    'dvl_lever_sigma': 0.0,
    'dvl_markov_sigma': 0.005,
    'dvl_markov_tau': 300.0,
    'dvl_misalignment_sigma_deg': 0.0,
    'dvl_rpy_deg': (0.0, 0.0, 0.0),
    'dvl_scale_sigma': 0.0001,
    'dvl_scale_velocity': 'predicted',
    'dvl_sigma': 0.005,
    'dvl_turn_velocity': 'measured',
    'filter_period_s': 0.1,
    'fix_clock_sigma': 0.0,
    'fix_heading_sigma_deg': 0.0,
    'fix_offset_sigma': 0.0,
    'fix_range_scale_sigma': 0.0,
    'forgetting': 0.99,
    'frame_id': 'earth',
    'gate_probability': 0.9999,
    'gyro_bias_sigma': 1.454e-07,
    'gyro_bias_walk': 0.0,
    'gyro_noise_density': 1.533e-09,
    'gap_attitude_sigma_deg': 5.7,
    'gap_velocity_sigma': 0.5,
    'heading_bias_sigma_deg': 4.5,
    'heading_bias_tau': 3600.0,
    'heading_declination_deg': 0.0,
    'heading_markov_sigma_deg': 2.0,
    'heading_markov_tau': 60.0,
    'heading_period_s': 1.0,
    'heading_reference': 'none',
    'heading_sigma_deg': 0.5,
    'heading_tilt_sigma_deg': 1.0,
    'heading_tilts': False,
    'heading_turn_factor': 1.0,
    'history_s': 65.0,
    'identify_current_limit': 2.0,
    'identify_current_sigma': 0.05,
    'identify_current_walks': (0.0, 3e-06, 3e-05, 0.0003),
    'identify_damping': 'adaptive',
    'identify_drag_ratio': 10.0,
    'identify_drag_sigma': 0.1,
    'identify_epsilon': 1e-06,
    'identify_every': 100,
    'identify_fixes': 300,
    'identify_gap_s': 5.0,
    'identify_heading_bias_sigma': 0.03,
    'identify_iterations': 200,
    'identify_least_fixes': 40,
    'identify_loss_scale': 2.0,
    'identify_method': 'robust',
    'identify_misfit': 2.0,
    'identify_mu': 1.0,
    'identify_nis_fixes': 20,
    'identify_nis_probability': 0.99,
    'identify_share_sigma': 0.15,
    'identify_window_s': 3600.0,
    'imu_gap_s': 0.0,
    'imu_missing': 'held',
    'imu_sample': 'mean',
    'imu_shock': 0.0,
    'initial_grid_heading_deg': 0.0,
    'initial_height': -100.0,
    'initial_latitude_deg': 80.0,
    'initial_longitude_deg': 120.0,
    'initial_pitch_deg': 0.0,
    'initial_roll_deg': 0.0,
    'initial_sigma_heading_deg': 0.08333333333333333,
    'initial_sigma_height': 5.0,
    'initial_sigma_position': 5.0,
    'initial_sigma_tilt_deg': 0.008333333333333333,
    'initial_sigma_velocity': 0.01,
    'initial_v_G': (0.0, 0.0, 0.0),
    'initialize': 'parameters',
    'leader_drift_sigma': 0.0,
    'leader_error_tau': 0.0,
    'leader_id': 1,
    'leader_link': 'present',
    'leader_shape': 'round',
    'lockstep': False,
    'lost_radius': 1000.0,
    'magnetic_year': 0.0,
    'map_axes': 'grid',
    'map_frame': '',
    'max_current': 3.0,
    'max_delay_s': 60.0,
    'max_depth': 12000.0,
    'max_fix_sigma': 0.0,
    'max_gated_s': 300.0,
    'max_imu_gap_s': 0.5,
    'max_imu_noise_factor': 1.0,
    'max_imu_repeats': 0,
    'max_instrument_repeats': 0,
    'max_rate': 1e300,
    'max_rate_leap': 1e300,
    'max_specific_force': 1e300,
    'max_speed': 20.0,
    'max_stamp_leap_s': 0.25,
    'min_fix_sigma': 0.0,
    'mode': 'sins',
    'model_acceleration_noise': 0.0014,
    'model_added_mass': (2.8, 65.5, 85.5),
    'model_aiding': False,
    'model_doubt': 0.0,
    'model_drag_linear': (15.0, 90.0, 90.0),
    'model_drag_quadratic': (90.0, 90.0, 90.0),
    'model_drag_sigma': 0.8,
    'model_drag_walk': 3.2e-05,
    'model_mass': 110.0,
    'model_net_buoyancy': 6.0,
    'model_share_sigma': 0.3,
    'model_speed': 1.1,
    'model_velocity_sigma': 0.01,
    'model_velocity_tau': 15.0,
    'model_vertical_sigma': 0.05,
    'noise_adaptation': 'none',
    'now_acceleration': 0.1,
    'now_blend_s': 2.0,
    'now_every': 1,
    'now_jump': 5.0,
    'now_jump_angle_deg': 20.0,
    'now_turn_acceleration': 0.05,
    'odom_frame': '',
    'origin_file': '',
    'output_period_s': 0.1,
    'own_id': 2,
    'presence': False,
    'publish_tf': True,
    'published_current': (0.0, 0.0),
    'published_fifo': 'kept',
    'published_fix_variance': 100.0,
    'published_noise': (1e-05, 0.2, 0.0001),
    'published_start': 0.0,
    'reopen_after_s': 0.0,
    'reorder_window_s': 0.05,
    'robust_fixes': 'none',
    'sea_surface_height': 0.0,
    'sensor_silent_s': 30.0,
    'sources': '',
    'state_file': '',
    'state_max_age_s': 60.0,
    'state_period_s': 5.0,
    'station_adaptation': 'auto',
    'station_attitude_sigma_deg': 0.66,
    'station_attitude_smoothing_s': 2.0,
    'station_bearing_error_deg': 1.0,
    'station_bearing_quantum_deg': 0.5,
    'station_bit_rate': 9600.0,
    'station_depth_noise': 0.1,
    'station_filter': 'augmented',
    'station_forgetting': 0.99,
    'station_heading_bias_sigma_deg': 1.7,
    'station_heading_bias_walk': 3.2e-06,
    'station_heading_sigma_deg': 0.0,
    'station_heading_tau': 3600.0,
    'station_height': -5.0,
    'station_latitude_deg': 80.0,
    'station_longitude_deg': 120.0,
    'station_packet_bits': 192.0,
    'station_position_noise': 0.002,
    'station_position_sigma': 0.0,
    'station_processing_s': 0.2,
    'station_range_error': 0.01,
    'station_range_quantum': 0.5,
    'station_range_scale_sigma': 0.0,
    'station_robust_probability': 0.99,
    'station_sound_speed': 1500.0,
    'station_turn_sigma_deg': 0.0,
    'station_validity': 'packet',
    'thrust_limit_n': 1e300,
    'thrust_timeout_s': 2.0,
    'transponder_lever_b': (0.0, 0.0, 0.0),
    'usbl_bias_sigma': 0.0,
    'usbl_bias_tau': 600.0,
    'water_sound_speed': 0.0,
    'water_track_sigma': 0.0,
    'water_track_tau': 60.0,
}
"""Engine 1. For a parameter that is new: the value with which engine 1 gives its bits."""

_SINCE: dict[int, dict[str, Any]] = {
    2: {
        'accel_bias_walk': 3e-06,
        'adaptive_ceiling': 25.0,
        'configuration': 'default',
        'depth_offset_sigma': 0.5,
        'dvl_latency_sigma': 0.05,
        'dvl_lever_sigma': 0.1,
        'dvl_misalignment_sigma_deg': 0.3,
        'dvl_scale_sigma': 0.004,
        'fix_clock_sigma': 0.01,
        'fix_heading_sigma_deg': 0.3,
        'fix_offset_sigma': 0.3,
        'fix_range_scale_sigma': 0.005,
        'gyro_bias_walk': 1.5e-09,
        'reopen_after_s': 10.0,
    },
    3: {
        'dvl_markov_sigma': 0.02,
        'max_fix_sigma': 10.0,
        'imu_gap_s': 0.1,
        'leader_error_tau': 3600.0,
        'station_position_sigma': 10.0,
        'station_range_scale_sigma': 0.005,
        'station_turn_sigma_deg': 0.5,
        'thrust_limit_n': 1000.0,
        'max_rate': 6.0,
        'max_specific_force': 60.0,
    },
    4: {
        'initialize': 'auto',
        'model_doubt': 10.0,
        'max_imu_repeats': 5,
    },
    5: {
        'leader_drift_sigma': 1.0,
        'water_track_sigma': 0.02,
    },
    6: {
        'dvl_turn_velocity': 'known',
    },
    7: {
        'accel_bias_walk': 2e-06,
        'gyro_bias_walk': 7e-10,
    },
    8: {
        'imu_missing': 'interpolated',
    },
    9: {
        'leader_link': 'kept',
    },
    10: {
        'max_rate_leap': 0.5,
    },
    15: {
        'dvl_scale_velocity': 'steady',
    },
    16: {
        'max_instrument_repeats': 5,
    },
    17: {
        'dvl_turn_velocity': 'carried',
    },
    18: {
        'min_fix_sigma': 0.1,
    },
    26: {
        'imu_shock': 10.0,
    },
    27: {
        'leader_error_tau': 5400.0,
        'leader_shape': 'way',
    },
}
"""By engine version: what changed with it. A version with new defaults counts up (version.py)."""

_MEANT: dict[int, dict[str, dict[str, Any]]] = {
    1: {
        'default': {
            'configuration': 'custom',
            'delay_handling': 'back_propagate',
            'noise_adaptation': 'none',
            'gate_probability': 0.9999,
            'robust_fixes': 'none',
        },
    },
}
"""By the last engine that meant it: what a named configuration of mode sins stood for."""


def as_recorded(params: Mapping[str, Any], engine_version: int) -> dict[str, Any]:
    """Return parameters with a configuration that was renamed since replaced by what it stood for.

    Parameters
    ----------
    params : mapping
        All parameters of a recording.
    engine_version : int
        As recorded on ``/run_info``; 1 where a bag states none.
    """
    if params['mode'] == 'sins':
        for version in sorted(_MEANT):
            if engine_version <= version and params['configuration'] in _MEANT[version]:
                return {**params, **_MEANT[version][params['configuration']]}
    return dict(params)


def defaults_of(engine_version: int) -> dict[str, Any]:
    """The follower's default parameters at an engine version, by name, in the declared units.

    A newer engine than this one gets the newest values that are known.

    Parameters
    ----------
    engine_version : int
        As recorded on ``/run_info``; 1 where a bag states none.
    """
    values = dict(_FIRST)
    for version in sorted(_SINCE):
        if version <= engine_version:
            values |= _SINCE[version]
    return values
