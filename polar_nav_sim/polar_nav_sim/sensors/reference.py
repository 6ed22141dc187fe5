"""Simulated errors of the leader's own navigation.

Position, velocity and attitude are off by Gauss-Markov processes of stated sigma and correlation
time, in grid axes; their stated covariance is that of the processes. Constant errors beside
them are never stated. All are zero by default: the papers assume a perfect leader.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.attitude import exp
from polar_nav_core.params import param, vector

from ..section import Spec
from .noise import CHUNK, Draws, GaussMarkov, Index

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ReferenceErrors(Spec):
    """Errors of the leader's navigation."""

    position_sigma_m: float = param(0.0, 'm', 0.0, 1e5, '1-sigma of the position error per axis')
    velocity_sigma: float = param(0.0, 'm/s', 0.0, 10.0, '1-sigma of the velocity error per axis')
    tilt_sigma_deg: float = param(0.0, 'deg', 0.0, 30.0, '1-sigma of roll and pitch')
    heading_sigma_deg: float = param(0.0, 'deg', 0.0, 180.0, '1-sigma of heading')
    error_tau_s: float = param(1800.0, 's', 1.0, 1e6, 'Correlation time of all of these')
    position_offset_m: tuple[float, ...] = vector(
        (0.0, 0.0, 0.0), 'm', -1e5, 1e5, 'Constant position error, grid axes, not stated'
    )
    heading_bias_deg: float = param(
        0.0, 'deg', -180.0, 180.0, 'Constant heading error, to port, not stated'
    )


@dataclass(frozen=True)
class NavigationError:
    """Errors at one sample, grid axes: position [m], velocity [m/s], attitude [rad]."""

    dr_G: Floats
    dv_G: Floats
    phi_G: Floats

    def attitude(self, C_b_G: Floats) -> Floats:
        """Attitude of the leader's estimate: exp(-[phi x]) C_b_G."""
        return np.asarray(exp(-self.phi_G) @ C_b_G)


class ReferenceSystem:
    """The leader's navigation.

    Parameters
    ----------
    errors : ReferenceErrors
        Its errors.
    period_s : float
        Time between samples [s].
    rng : numpy.random.Generator
        Its own stream.
    """

    def __init__(self, errors: ReferenceErrors, period_s: float, rng: np.random.Generator) -> None:
        tilt, heading = np.radians([errors.tilt_sigma_deg, errors.heading_sigma_deg])
        self.sigma = np.array(
            [*[errors.position_sigma_m] * 3, *[errors.velocity_sigma] * 3, tilt, tilt, heading]
        )
        first = rng.standard_normal(9)
        self._process = GaussMarkov(self.sigma, errors.error_tau_s, period_s, first)
        self._draws = Draws(rng, 9)
        self._index = Index()
        self._rows = np.empty((0, 9))
        self._constant = np.zeros(9)
        self._constant[:3] = errors.position_offset_m
        # The attitude is turned by -phi.
        self._constant[8] = -np.radians(errors.heading_bias_deg)

    def error(self, k: int) -> NavigationError:
        """Errors at sample k; numbers never go back."""
        self._index.take(k, 1)
        chunk, row = divmod(k, CHUNK)
        while self._draws.chunk < chunk:
            self._rows = self._process.advance(self._draws.advance())
        x = self._rows[row] + self._constant
        return NavigationError(x[:3], x[3:6], x[6:])
