"""A world whose every constant, slow and common error is drawn from sigmas that a filter states.

Fixes come from a leader abeam in formation, or from one that stays; their lines let range scale
and array turn act. The signs are drawn, but for the age of a ping, which is never negative: its
second moment is that of the sigma.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polar_nav_core.attitude import exp
from polar_nav_core.engine.params import EngineParams

from ..mismatch import worlds
from ..mismatch.dvl_faults import DvlPlace
from ..world import World
from ..world_spec import WorldSpec

ABOVE_M = 40.0
"""Height of the leader's array above the follower's transponder [m]."""


def stated_world() -> dict[str, Any]:
    """Fields of a WorldSpec whose sensor classes are the engine's defaults."""
    usual = EngineParams()
    return {
        'constants': 'prior',
        'gyro_bias_dph': float(np.rad2deg(usual.gyro_bias_sigma) * 3600.0),
        'accel_bias_g': usual.accel_bias_sigma / 9.80665,
        'dvl_scale': usual.dvl_scale_sigma,
        'dvl_markov_sigma': usual.dvl_markov_sigma,
        'dvl_markov_tau_s': usual.dvl_markov_tau,
        'dvl_sigma': usual.dvl_sigma,
        'depth_sigma': usual.depth_sigma,
    }


@dataclass(frozen=True)
class Drawn:
    """Draws walks and common errors for a world, from the sigmas of some parameters.

    Attributes
    ----------
    distance_m : float
        Of the leader abeam at the start.
    formation : bool
        Whether it keeps there; otherwise it stays.
    stated : EngineParams
    """

    distance_m: float = 500.0
    formation: bool = True
    stated: EngineParams = field(default_factory=EngineParams)

    def __call__(self, world: World) -> World:
        """World with the errors."""
        rng = worlds.drawn(world, 'evidence')
        world = self._fixes(world, rng)
        world = self._dvl(world, rng)
        world = worlds.add_depth(world, self.stated.depth_offset_sigma * rng.standard_normal())
        n = len(world.inputs.imu_stamps_ns)
        step_s = np.sqrt(1.0 / world.spec.imu_rate_hz)
        walk = step_s * np.cumsum(rng.standard_normal((2, n, 3)), axis=1)
        return worlds.add_imu(
            world, self.stated.gyro_bias_walk * walk[0], self.stated.accel_bias_walk * walk[1]
        )

    def _fixes(self, world: World, rng: np.random.Generator) -> World:
        s = self.stated
        line_G = np.tile(-self.distance_m * worlds.abeam_G(world), (len(world.inputs.fixes), 1))
        line_G[:, 2] -= ABOVE_M
        if not self.formation:
            line_G += worlds.from_start_G(world, worlds.truth_of_fixes(world).r_e)
        across_G = np.cross(np.array([0.0, 0.0, 1.0]), line_G)
        scale = s.fix_range_scale_sigma * rng.standard_normal()
        turn = np.deg2rad(s.fix_heading_sigma_deg) * rng.standard_normal()
        offset_G = s.fix_offset_sigma * rng.standard_normal(3)
        late_ns = round(s.fix_clock_sigma * rng.standard_normal() * 1e9)
        world = worlds.see_fixes_along(world, line_G)
        world = worlds.move_fixes(world, scale * line_G + turn * across_G + offset_G)
        return worlds.restamp_fixes(world, [late_ns] * len(world.inputs.fixes))

    def _dvl(self, world: World, rng: np.random.Generator) -> World:
        s = self.stated
        x, y = s.dvl_lever_sigma * rng.standard_normal(2)
        age_s = s.dvl_latency_sigma * abs(rng.standard_normal())
        pitch, yaw = np.deg2rad(s.dvl_misalignment_sigma_deg) * rng.standard_normal(2)
        world = DvlPlace(lever_b=(x, y, 0.0), lag_s=age_s).applied(world, 1.0)
        v_m = world.inputs.dvl_v_m
        turned = v_m @ exp(np.array([0.0, pitch, yaw])).T
        return worlds.add_dvl(world, turned - v_m)


def world_of(duration_s: float, **changes: Any) -> WorldSpec:  # noqa: ANN401 - of WorldSpec
    """Return the world of the engine's default classes."""
    rates = {'dvl_rate_hz': 5.0, 'depth_rate_hz': 5.0}
    return WorldSpec(**{'duration_s': duration_s, **rates, **stated_world(), **changes})
