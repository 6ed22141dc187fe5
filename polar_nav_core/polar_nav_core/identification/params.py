"""Parameters of the identification of drag and current; `EngineParams` inherits them."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import ConfigError
from ..params import choice, param, vector
from .model_params import ModelParams

METHODS = ('robust', 'published')
DAMPINGS = ('adaptive', 'fixed')


@dataclass(frozen=True)
class IdentificationParams(ModelParams):
    """Method and triggers of the identification, and limits of a result that is used."""

    identify_method: str = choice(
        'robust', (*METHODS, 'none'), 'How drag and current are identified by themselves'
    )
    identify_fixes: int = param(300, '', 10, 100000, 'Fixes in a full window, the newest ones')
    identify_every: int = param(
        100,
        '',
        1,
        100000,
        'New fixes from one identification to the next, once the window is full',
    )
    identify_least_fixes: int = param(
        40, '', 10, 100000, 'Least number of fixes of an identification'
    )
    identify_window_s: float = param(
        3600.0, 's', 10.0, 1e6, 'Fixes older than that against the newest are left out'
    )
    identify_gap_s: float = param(
        5.0, 's', 0.1, 600.0, 'Longest gap in attitude or thrust that a window may span'
    )
    identify_nis_fixes: int = param(
        20, '', 1, 10000, 'Fixes in the mean NIS that triggers an identification'
    )
    identify_nis_probability: float = param(
        0.99, '', 0.5, 0.999999, 'Probability of a mean NIS below its limit with a right model'
    )
    identify_loss_scale: float = param(
        2.0, 'sigma', 0.1, 100.0, 'Residual from which the robust loss turns from square to linear'
    )
    identify_heading_bias_sigma: float = param(
        0.03, 'rad', 1e-6, 1.0, '1-sigma of the heading bias before the fixes'
    )
    identify_current_walks: tuple[float, ...] = vector(
        (0.0, 3e-6, 3e-5, 3e-4),
        'm^2/s^3',
        0.0,
        1.0,
        "Densities q_c of the current's random walk within the window: the likeliest is used",
    )
    identify_drag_sigma: float = param(
        0.1, '', 1e-6, 10.0, 'Largest 1-sigma of ln(total surge drag) of a result that is used'
    )
    identify_share_sigma: float = param(
        0.15, '', 1e-6, 10.0, 'Largest 1-sigma of the quadratic share of a result that is used'
    )
    identify_current_sigma: float = param(
        0.05, 'm/s', 1e-6, 10.0, 'Largest 1-sigma of the current of a result that is used'
    )
    identify_current_limit: float = param(
        2.0, 'm/s', 0.01, 20.0, 'Largest current of a result that is used'
    )
    identify_drag_ratio: float = param(
        10.0, '', 1.01, 1000.0, 'Total drag may differ from the nominal one by this factor'
    )
    identify_misfit: float = param(
        2.0,
        '',
        1.0,
        100.0,
        'Largest accepted ratio of the residuals to the stated errors of the fixes',
    )
    identify_damping: str = choice(
        'adaptive', DAMPINGS, 'Published method: whether mu of Levenberg-Marquardt changes'
    )
    identify_mu: float = param(
        1.0, '', 0.0, 1e9, 'Published method: mu of Levenberg-Marquardt, or its first value'
    )
    identify_epsilon: float = param(
        1e-6, '', 1e-12, 1.0, 'Published method: length of the last step of the parameters'
    )
    identify_iterations: int = param(200, '', 1, 100000, 'Published method: most iterations')

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.identify_least_fixes > self.identify_fixes:
            raise ConfigError(
                f'parameter identify_least_fixes: {self.identify_least_fixes} is more than '
                f'identify_fixes, which is {self.identify_fixes}'
            )
