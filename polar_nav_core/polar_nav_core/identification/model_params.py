"""Parameters of a vehicle's dynamic model (docs/derivations/vehicle_model.md)."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import ConfigError
from ..params import NodeParams, flag, param, sigma, vector
from ..vehicle_model import VehicleModel


@dataclass(frozen=True)
class ModelParams(NodeParams):
    """Parameters of the dynamic model, and 1-sigma of them and of the current."""

    model_mass: float = param(110.0, 'kg', 0.1, 1e6, 'Mass of the vehicle')
    model_added_mass: tuple[float, ...] = vector(
        (2.8, 65.5, 85.5), 'kg', 0.0, 1e6, 'Added mass: surge, sway, heave'
    )
    model_drag_linear: tuple[float, ...] = vector(
        (15.0, 90.0, 90.0), 'N s/m', 0.0, 1e6, 'Drag per speed: surge, sway, heave'
    )
    model_drag_quadratic: tuple[float, ...] = vector(
        (90.0, 90.0, 90.0), 'N s^2/m^2', 0.0, 1e6, 'Drag per speed squared: surge, sway, heave'
    )
    model_net_buoyancy: float = param(6.0, 'N', -1e5, 1e5, 'Buoyancy minus weight')
    model_speed: float = param(
        1.1, 'm/s', 0.05, 20.0, 'Speed at which total drag and its quadratic share are stated'
    )
    model_drag_sigma: float = param(0.8, '', 1e-6, 3.0, '1-sigma of ln(total surge drag)')
    model_share_sigma: float = param(
        0.3, '', 1e-6, 1.0, '1-sigma of the share of the drag that is quadratic'
    )
    model_drag_walk: float = param(
        3.2e-5, '1/sqrt(s)', 0.0, 1.0, 'Random walk of both drag parameters'
    )
    model_acceleration_noise: float = param(
        1.4e-3, 'm/s/sqrt(s)', 1e-9, 1.0, 'Unmodelled acceleration, as a random walk of v_r'
    )
    current_sigma: float = param(
        0.4, 'm/s', 1e-6, 10.0, '1-sigma of the current at the start, per axis'
    )
    current_walk: float = param(
        1e-5, 'm^2/s^3', 0.0, 1.0, "Density q_c of the current's random walk"
    )

    model_aiding: bool = flag(
        False, 'Whether the model takes part beside the inertial navigation: v_G = C_b_G v_r + V_c'
    )
    model_velocity_sigma: float = param(
        0.01, 'm/s', 1e-5, 10.0, '1-sigma of the error of that equation, horizontal, per axis'
    )
    model_vertical_sigma: float = param(
        0.05, 'm/s', 1e-5, 10.0, 'The same, vertical: the current there and an error of buoyancy'
    )
    model_velocity_tau: float = param(
        15.0, 's', 0.0, 3600.0, 'How long such an error lasts (correlation time)'
    )
    water_track_sigma: float = sigma(
        0.02,
        'm/s',
        10.0,
        '1-sigma of what lasts in a DVL velocity through the water beside the current (layer, '
        'wake), per axis; used with model_aiding and without bottom lock; 0: not used',
    )
    water_track_tau: float = param(
        60.0, 's', 0.0, 3600.0, 'How long such an error lasts (correlation time)'
    )
    thrust_limit_n: float = param(
        1000.0,
        'N',
        1.0,
        1e300,
        'Largest force per axis of a thrust that is used; the one before holds on instead',
    )
    thrust_timeout_s: float = param(
        2.0,
        's',
        0.01,
        3600.0,
        'A thrust without a newer one counts as unknown after this; in station mode it holds '
        'on, with the noise of a guess',
    )
    bottom_lock_timeout_s: float = param(
        1.5, 's', 0.05, 60.0, 'Model aiding: without a good DVL ping for longer, lock is lost'
    )
    bottom_lock_pings: int = param(
        3, '', 1, 1000, 'Model aiding: good pings in a row until a lost DVL is used again'
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.vehicle_model().total_drag(self.model_speed) <= 0.0:
            raise ConfigError(
                'parameters model_drag_linear, model_drag_quadratic: surge has no drag at all'
            )

    def vehicle_model(self) -> VehicleModel:
        """Return the model that these parameters state."""
        return VehicleModel.of(
            self.model_mass,
            self.model_added_mass,
            self.model_drag_linear,
            self.model_drag_quadratic,
            self.model_net_buoyancy,
        )
