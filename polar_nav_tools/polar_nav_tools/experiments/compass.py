"""A measured heading in a simulated world, and how a filter that uses it is set."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors.compass import CompassErrors, measured_headings

from .world import World

PERIOD_S = 0.5


def with_headings(
    world: World, reference: str, errors: CompassErrors, bias_sigma_deg: float
) -> World:
    """World whose vehicle has an AHRS with a bias drawn from its sigma [deg]."""
    rng = stream(world.seed, 'follower/compass')
    stride = max(1, round(PERIOD_S * world.spec.imu_rate_hz))
    stamps = world.inputs.imu_stamps_ns[::stride]
    errors = replace(errors, bias_deg=errors.bias_deg + bias_sigma_deg * rng.standard_normal())
    s = world.truth.state(stamps)
    headings, up_b = measured_headings(
        errors, reference, stamps, s.r_e, s.C_e_G, s.C_b_G, s.v_G, rng
    )
    inputs = replace(world.inputs, heading_stamps_ns=stamps, headings=headings, heading_up_b=up_b)
    return replace(world, inputs=inputs)


def turn_headings(world: World, angle: Array) -> World:
    """World whose headings are turned by angles (n,) [rad], clockwise."""
    x = world.inputs
    turned = np.remainder(x.headings + angle + np.pi, 2.0 * np.pi) - np.pi
    return replace(world, inputs=replace(x, headings=turned))


def stated(reference: str, bias_sigma_deg: float, **changes: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return what a user states of an AHRS: what headings count from, and how good they are."""
    return {
        'heading_reference': reference,
        'heading_bias_sigma_deg': bias_sigma_deg,
        **changes,
    }
