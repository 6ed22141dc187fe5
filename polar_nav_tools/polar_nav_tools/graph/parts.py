"""Common nodes and parameters of the graphs of all missions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from polar_nav_core.engine.params import EngineParams
from polar_nav_core.params import default_of
from polar_nav_sim.initial_state import InitialSigma, initial_parameters
from polar_nav_sim.randomness import stream

from .spec import NodeSpec, ParameterValue, Stage

if TYPE_CHECKING:
    from polar_nav_sim.mission import Mission

LOCKSTEP_WINDOW_S = 1.0
"""Truth that is published at once: long enough that acknowledging costs little, and a hundred IMU
samples are far fewer than a queue holds."""
LOCKSTEP_REORDER_S = 2.0 * LOCKSTEP_WINDOW_S
"""Within a window the topics come in any order, and so do those of the window after it."""
LEADER_ID, FOLLOWER_ID = 1, 2
"""Numbers of the vehicles in acoustic packets; a station has that of the leader."""
LINK: dict[str, ParameterValue] = {
    'random_delay': 'exponential',
    'random_delay_mean_s': 0.5,
    'random_delay_max_s': 10.0,
    'loss_probability': 0.05,
    'bit_error_rate': 1e-4,
}
"""An acoustic link as one meets it: now and then a packet is late, lost or damaged."""


def sim_node(
    executable: str, namespace: str, stage: Stage, parameters: Mapping[str, ParameterValue]
) -> NodeSpec:
    """Node of polar_nav_sim as data."""
    module = f'polar_nav_sim.nodes.{executable}'
    return NodeSpec('polar_nav_sim', executable, module, namespace, stage, parameters)


def usual_sigma(kind: type[EngineParams]) -> InitialSigma:
    """1-sigma of the initial state by a node's default parameters."""
    return InitialSigma(
        position=default_of(kind, 'initial_sigma_position'),
        height=default_of(kind, 'initial_sigma_height'),
        velocity=default_of(kind, 'initial_sigma_velocity'),
        tilt_deg=default_of(kind, 'initial_sigma_tilt_deg'),
        heading_deg=default_of(kind, 'initial_sigma_heading_deg'),
    )


def initial_state_parameters(
    mission: Mission,
    vehicle: str,
    sigma: InitialSigma,
    seed: int,
    *,
    through_water: bool = False,
) -> dict[str, ParameterValue]:
    """Initial state of a vehicle as parameters: truth plus errors drawn with these sigmas.

    Its velocity is that over ground, or that through the water.
    """
    # The first IMU sample ends the first interval: that is when the filter starts.
    first_ns = mission.start_ns + mission.imu_period_ns
    rng = stream(seed, f'{vehicle}/initial_state')
    truth = mission.truth(vehicle).state(first_ns)
    if through_water:
        truth = replace(truth, v_G=truth.v_G - truth.current_G)
    return dict(initial_parameters(truth, sigma, rng))


def link_node(vehicles: list[str], seed: int) -> NodeSpec:
    """Node of the acoustic link between the modems."""
    parameters: dict[str, ParameterValue] = {'seed': seed, **LINK, 'vehicles': vehicles}
    return sim_node('acoustic_link_node', '', Stage.LINK, parameters)
