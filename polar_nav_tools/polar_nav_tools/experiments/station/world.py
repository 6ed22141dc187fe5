"""A simulated run of the station scenario: inputs of the engine, and truth.

Made from the arrays of `polar_nav_sim.offline_station`. Truth
and noise depend on the seed and the scenario only: filters that are compared at one seed see the
same numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from polar_nav_core import attitude, earth, grid
from polar_nav_core.arrays import Array
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.inputs import StationInputs
from polar_nav_core.engine.params import NO_COMMON_ERRORS, EngineParams
from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_core.identification.window import PositionFix, position_fix
from polar_nav_core.vehicle_model import steady_speed
from polar_nav_sim.mission import load_mission
from polar_nav_sim.offline_station import StationRun, StationScenario, simulate
from polar_nav_sim.randomness import stream

from ..station_choices import StationChoices

NS = 1_000_000_000
_SOURCE = 'station'
_NO_POSITION = np.full(3, np.nan)
_NO_COVARIANCE = np.full((3, 3), np.nan)


@dataclass(frozen=True)
class StationWorld:
    """One simulated run.

    Attributes
    ----------
    run : StationRun
        Sensors, fixes and truth.
    inputs : StationInputs
        Inputs with fixes as they arrived, delayed further by ``later_s``.
    origin_e : (3,) array
        Origin of the station frame, ECEF [m].
    C_e_S : (3, 3) array
        ECEF to station axes.
    fix_positions : tuple of PositionFix
        Fixes as horizontal positions, at the true height, in the order of arrival.
    """

    run: StationRun
    inputs: StationInputs
    origin_e: Array
    C_e_S: Array
    fix_positions: tuple[PositionFix, ...]

    def as_of_arrival(self) -> StationInputs:
        """Inputs whose fixes state their reception as time of validity."""
        fixes = tuple(replace(f, validity_ns=f.receive_ns) for f in self.inputs.fixes)
        return replace(self.inputs, fixes=fixes)

    def fix_errors(self) -> Array:
        """Errors of the fixes at their validity [m], shape (k, 2)."""
        positions = np.array([[f.x, f.y] for f in self.fix_positions]).reshape(-1, 2)
        return np.asarray(positions - self.run.fixes.true_position[: len(positions), :2])

    def params(
        self,
        choices: StationChoices,
        later_s: float,
        **changes: Any,  # noqa: ANN401 - of EngineParams
    ) -> EngineParams:
        """Engine parameters for this station and these sensors, with ``changes``."""
        s = self.run.scenario
        latitude, longitude, height = (float(v) for v in earth.geodetic_from_ecef(self.origin_e))
        values: dict[str, Any] = {
            **NO_COMMON_ERRORS,
            'mode': 'station',
            'configuration': 'default',
            'station_latitude_deg': math.degrees(latitude),
            'station_longitude_deg': math.degrees(longitude),
            'station_height': height,
            'station_sound_speed': s.assumed_sound_speed or s.sound_speed,
            'station_bit_rate': s.bit_rate,
            'station_processing_s': s.processing_s + later_s,
            'station_heading_sigma_deg': math.degrees(s.station_heading_sigma),
            'output_period_s': choices.output_period_s,
            **self._initial(choices),
        }
        return EngineParams(**{**values, **changes, **choices.engine})

    def _initial(self, c: StationChoices) -> dict[str, Any]:
        """Initial state near the truth, at the nominal steady speed, without current."""
        r = self.run
        rng = stream(r.seed, 'experiment/station/initial')
        error_S = np.append(c.initial_sigma_position * rng.standard_normal(2), 0.0)
        r_e = self.origin_e + self.C_e_S.T @ (r.p[0] + error_S)
        latitude, longitude, height = (float(v) for v in earth.geodetic_from_ecef(r_e))
        model = EngineParams().vehicle_model()
        speed = steady_speed(
            float(r.force_b[0, 0]), float(model.drag_linear[0]), float(model.drag_quadratic[0])
        )
        v_G = speed * r.C_b_G[0, :, 0] * np.array([1.0, 1.0, 0.0])
        return {
            'initial_latitude_deg': math.degrees(latitude),
            'initial_longitude_deg': math.degrees(longitude),
            'initial_height': height,
            'initial_v_G': tuple(float(v) for v in v_G),
            'initial_sigma_position': c.initial_sigma_position,
            'initial_sigma_height': 1.0,
            'initial_sigma_velocity': c.initial_sigma_velocity,
        }


@lru_cache(maxsize=1)
def make_world(
    scenario: StationScenario, seed: int, depth_sigma: float, later_s: float
) -> StationWorld:
    """World of a simulated run.

    Parameters
    ----------
    scenario : StationScenario
    seed : int
    depth_sigma : float
        1-sigma of depth set in the filter [m].
    later_s : float
        How much later than simulated every packet arrives [s].
    """
    run = simulate(scenario, seed)
    origin_e = _origin(scenario.mission)
    C_e_S = np.asarray(grid.ecef_to_grid(origin_e))
    stamps = run.start_ns + np.rint(run.t_s * NS).astype(np.int64)
    inputs = StationInputs(
        imu_stamps_ns=stamps,
        omega_ib_b=run.omega_ib_b,
        C_b_G=run.C_b_G,
        control_stamps_ns=stamps,
        force_b=run.force_b,
        depth_stamps_ns=stamps,
        depth=run.depth,
        depth_variance=np.full(len(stamps), depth_sigma**2),
        fixes=_fixes(run, later_s),
    )
    heights = run.fixes.true_position[: len(inputs.fixes), 2]
    positions = tuple(
        position_fix(f.validity_ns, f.polar, float(z))
        for f, z in zip(inputs.fixes, heights, strict=True)
        if f.polar is not None
    )
    return StationWorld(run, inputs, origin_e, C_e_S, positions)


@lru_cache(maxsize=4)
def _origin(mission_name: str) -> Array:
    """Position of the station, ECEF [m]."""
    mission = load_mission(mission_name)
    return np.array(mission.truth(mission.leader).state(mission.start_ns).r_e)


def _fixes(run: StationRun, later_s: float) -> tuple[Fix, ...]:
    f = run.fixes

    def stamp(seconds: float) -> int:
        return run.start_ns + round(seconds * NS)

    return tuple(
        Fix(
            validity_ns=stamp(f.validity_s[k]),
            transmit_ns=stamp(f.transmit_s[k] + later_s),
            receive_ns=stamp(f.receive_s[k] + later_s),
            source=_SOURCE,
            sequence=int(f.sequence[k]),
            order=k,
            arrival=k,
            r_e=_NO_POSITION,
            covariance_e=_NO_COVARIANCE,
            polar=PolarFix(
                station=f.station_position[k],
                station_heading=float(f.station_heading[k]),
                station_heading_sigma=float(f.station_heading_sigma[k]),
                range=float(f.range[k]),
                range_sigma=float(f.range_sigma[k]),
                bearing=float(f.bearing[k]),
                bearing_sigma=float(f.bearing_sigma[k]),
                sound_speed=float(f.sound_speed[k]),
            ),
        )
        for k in range(len(f.sequence))
        if f.receive_s[k] + later_s <= run.t_s[-1]
    )


def heading_and_pitch(C_b_G: Array) -> tuple[Array, Array]:
    """Heading and pitch of attitudes (n, 3, 3), each (n,) [rad]."""
    psi, theta, _ = attitude.euler_from_matrix(C_b_G)
    return np.asarray(psi), np.asarray(theta)
