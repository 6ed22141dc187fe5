"""A vehicle in a current, a station that measures it, and what an identification sees of it.

Surge, sway and yaw of the full model with the true parameters and scenario of the DVL-less paper,
Runge-Kutta on the continuous laws of thrust and heading: nothing is shared with the code under
test but the parameters' meaning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from polar_nav_core.identification.identifier import Identifier
from polar_nav_core.identification.params import IdentificationParams
from polar_nav_core.identification.polar_fix import PolarFix
from polar_nav_core.identification.window import position_fix

SECOND_NS = 1_000_000_000
EPOCH_NS = 1_700_000_000 * SECOND_NS
MASS, ADDED = 100.0, (1.8, 76.5)
SURGE_DRAG, SWAY_DRAG = (25.0, 19.0), (105.0, 105.0)
STATION = np.array([600.0, -500.0, -5.0])
STATION_HEADING = 0.3
DEPTH_Z = -20.0
START = (-250.0, -150.0)
TOTAL = SURGE_DRAG[0] * 1.1 + SURGE_DRAG[1] * 1.1**2
TRUE_MODEL = {
    'model_mass': MASS,
    'model_added_mass': (*ADDED, 76.5),
    'model_drag_linear': (SURGE_DRAG[0], SWAY_DRAG[0], 105.0),
    'model_drag_quadratic': (SURGE_DRAG[1], SWAY_DRAG[1], 105.0),
    'model_net_buoyancy': 5.0,
}


def busy_thrust(t):
    return 52.0 + 18.0 * np.sin(0.05 * t) + 14.0 * np.sin(0.013 * t)


def busy_heading(t):
    return 1.9 * np.sin(0.011 * t) + 0.45 * np.sin(0.037 * t) + 0.3


def constant_current(_t):
    return 0.4, 0.25


@dataclass(frozen=True)
class Scene:
    """What the vehicle does, and the water."""

    thrust: Callable = busy_thrust
    heading: Callable = busy_heading
    current: Callable = constant_current
    duration: float = 762.0


PAPER = Scene()


@dataclass(frozen=True)
class Truth:
    """Ten times a second: thrust held over each interval, as a node publishes it."""

    t: np.ndarray
    psi: np.ndarray
    yaw_rate: np.ndarray
    force: np.ndarray
    surge: np.ndarray
    position: np.ndarray


@cache
def sail(scene: Scene = PAPER) -> Truth:
    h = 0.1
    t = h * np.arange(round(scene.duration / h) + 1)
    force = np.asarray(scene.thrust(t), dtype=float) + np.zeros_like(t)
    eps = 1e-4

    def psi_rate(s):
        return (scene.heading(s + eps) - scene.heading(s - eps)) / (2 * eps)

    m_u, m_v = MASS + ADDED[0], MASS + ADDED[1]

    def rate(s, state, tau):
        u, v, _, _ = state
        psi, r = scene.heading(s), psi_rate(s)
        c_x, c_y = scene.current(s)
        return np.array(
            [
                (tau + m_v * r * v - (SURGE_DRAG[0] + SURGE_DRAG[1] * abs(u)) * u) / m_u,
                (-m_u * r * u - (SWAY_DRAG[0] + SWAY_DRAG[1] * abs(v)) * v) / m_v,
                np.cos(psi) * u - np.sin(psi) * v + c_x,
                np.sin(psi) * u + np.cos(psi) * v + c_y,
            ]
        )

    d1, d2 = SURGE_DRAG
    u = 2.0 * force[0] / (d1 + np.sqrt(d1 * d1 + 4.0 * d2 * force[0]))
    state = np.array([u, 0.0, *START])
    states = [state]
    for k in range(len(t) - 1):
        a = rate(t[k], state, force[k])
        b = rate(t[k] + h / 2, state + h / 2 * a, force[k])
        c = rate(t[k] + h / 2, state + h / 2 * b, force[k])
        d = rate(t[k] + h, state + h * c, force[k])
        state = state + h / 6 * (a + 2 * b + 2 * c + d)
        states.append(state)
    states = np.array(states)
    psi = np.asarray(scene.heading(t), dtype=float) + np.zeros_like(t)
    return Truth(t, psi, psi_rate(t) + np.zeros_like(t), force, states[:, 0], states[:, 2:])


@dataclass(frozen=True)
class Sensors:
    """Amplitudes of uniform errors, as the scenario has them; 0 is noise free."""

    share: float = 1.0
    seed: int = 0
    loss: float = 0.0
    heading_bias: float = 0.0
    period: float = 2.5
    first: float = 10.0
    outliers: float = 0.0
    station_heading_error: float = 0.0
    station_heading_sigma: float = 0.0
    stated: float = field(default=1.0)


SILENT = Sensors(share=0.0)


def polar_fixes(truth: Truth, sensors: Sensors) -> list[tuple[int, PolarFix]]:
    """(validity, fix) in order of validity."""
    rng = np.random.default_rng([sensors.seed, 1])
    out = []
    for s in np.arange(sensors.first, truth.t[-1], sensors.period):
        p = [np.interp(s, truth.t, truth.position[:, k]) for k in range(2)]
        r = np.array([*p, DEPTH_Z]) - STATION
        distance = np.linalg.norm(r)
        bearing = np.arctan2(r[1], r[0]) - STATION_HEADING - sensors.station_heading_error
        u = rng.uniform(-1.0, 1.0, 2) * sensors.share
        if sensors.share:
            measured = np.round(distance * (1.0 + 0.01 * u[0]) / 0.5) * 0.5
            angle = np.deg2rad(np.round((np.rad2deg(bearing) + u[1]) / 0.5) * 0.5)
        else:
            measured, angle = distance, bearing
        if rng.random() < sensors.outliers:
            angle += np.deg2rad(20.0)
        sigma_r = np.sqrt((0.01 * measured) ** 2 / 3 + 0.5**2 / 12) * sensors.stated
        sigma_a = np.deg2rad(np.sqrt(1.0 / 3 + 0.25 / 12)) * sensors.stated
        fix = PolarFix(
            STATION,
            STATION_HEADING,
            sensors.station_heading_sigma,
            measured,
            sigma_r,
            angle,
            sigma_a,
            1500.0,
        )
        if rng.random() >= sensors.loss:
            out.append((EPOCH_NS + round(s * 1e9), fix))
    return out


def identifier_of(
    scene: Scene = PAPER,
    sensors: Sensors = SILENT,
    params: IdentificationParams | None = None,
    **changes,
) -> Identifier:
    """An identifier that has seen the whole of a run."""
    truth = sail(scene)
    params = replace(params or IdentificationParams(), **changes)
    identifier = Identifier(params)
    feed_log(identifier, truth, sensors)
    for validity_ns, polar in polar_fixes(truth, sensors):
        identifier.add_fix(position_fix(validity_ns, polar, DEPTH_Z))
    return identifier


def feed_log(identifier: Identifier, truth: Truth, sensors: Sensors) -> None:
    rng = np.random.default_rng([sensors.seed, 2])
    n = len(truth.t)
    psi = truth.psi + sensors.heading_bias + 0.02 * sensors.share * rng.uniform(-1, 1, n)
    psi = np.arctan2(np.sin(psi), np.cos(psi))  # as a sensor gives it
    rate = truth.yaw_rate + 0.01 * sensors.share * rng.uniform(-1, 1, n)
    for k in range(n):
        stamp_ns = EPOCH_NS + round(truth.t[k] * 1e9)
        identifier.add_heading(stamp_ns, psi[k], 0.0, rate[k])
        identifier.add_control(stamp_ns, np.array([truth.force[k], 0.0, 0.0]))
