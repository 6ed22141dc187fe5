"""Errors of a run in station mode against its truth, and their metrics.

Position errors are along the station frame's x and y, velocity errors along body x and y, both
estimate minus truth, as in the paper's figures 5 and 8.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polar_nav_core.arrays import Array

BEFORE = (30.0, 750.0)
CONVERGED = (250.0, 750.0)
AFTER = (950.0, 1590.0)
"""Windows [s]: before the adaptation of 750 s, after the start has died away, and well after."""
ADAPTED_S = 750.0
SETTLED_M, SETTLED_S = 8.0, 60.0
"""Limit [m] and duration [s] of a settled error."""
AXES = 'xy'


@dataclass(frozen=True)
class StationErrors:
    """Errors of n estimates and k fixes.

    Attributes
    ----------
    time_s : (n,) array
        Since the start of the mission [s].
    position : (n, 2) array
        Error [m], station frame.
    velocity_b : (n, 2) array
        Error of the velocity over ground, body x and y [m/s].
    covariance : (n, 2, 2) array
        Of position as the filter states it [m^2].
    fix_time_s : (k,) array
        When fixes are valid [s].
    fix : (k, 2) array
        Their errors [m].
    nis_time_s, nis : (m,) arrays
        Of fixes that were judged; two degrees of freedom.
    """

    time_s: Array
    position: Array
    velocity_b: Array
    covariance: Array
    fix_time_s: Array
    fix: Array
    nis_time_s: Array
    nis: Array

    def window(self, first_s: float, last_s: float) -> StationErrors:
        """Errors between two times, both included."""

        def within(time_s: Array) -> NDArray[np.bool_]:
            return (time_s >= first_s) & (time_s <= last_s)

        rows, fixes, judged = (within(t) for t in (self.time_s, self.fix_time_s, self.nis_time_s))
        return replace(
            self,
            time_s=self.time_s[rows],
            position=self.position[rows],
            velocity_b=self.velocity_b[rows],
            covariance=self.covariance[rows],
            fix_time_s=self.fix_time_s[fixes],
            fix=self.fix[fixes],
            nis_time_s=self.nis_time_s[judged],
            nis=self.nis[judged],
        )

    def nees(self) -> Array:
        """Normalized squared error of position, shape (n,): two degrees of freedom."""
        solved = np.linalg.solve(self.covariance, self.position[..., None])[..., 0]
        return np.asarray(np.einsum('ni,ni->n', self.position, solved))


def measure(errors: StationErrors) -> dict[str, float]:
    """Metrics of one run.

    RMS and largest error of position (``rms_x``, ``max_x`` [m]) and velocity (``rms_vx``,
    ``max_vx`` [m/s]), mean NIS per fix (``nis``, 2 is honest) and mean NEES of position per degree
    of freedom (``nees``, 1 is honest), each in the windows `BEFORE`, `CONVERGED` and `AFTER`
    (``_before``, ``_converged``, ``_after``); ``worst``, the largest horizontal error from the
    first window's start on; ``settle_s``, how long after the adaptation's time both errors begin
    to stay below `SETTLED_M` for `SETTLED_S`. Windows beyond the run's end are left out.
    """
    out: dict[str, float] = {}
    for name, (first_s, last_s) in (
        ('before', BEFORE),
        ('converged', CONVERGED),
        ('after', AFTER),
    ):
        part = errors.window(first_s, last_s)
        if len(part.time_s):
            out |= {f'{key}_{name}': value for key, value in _window(part).items()}
    late = errors.window(BEFORE[0], np.inf)
    if len(late.time_s):
        out['worst'] = float(np.hypot(late.position[:, 0], late.position[:, 1]).max())
    if len(errors.time_s) and errors.time_s[-1] > ADAPTED_S + SETTLED_S:
        out['settle_s'] = _settled(errors.window(ADAPTED_S, np.inf))
    return out


def _settled(e: StationErrors) -> float:
    """Time [s] after `ADAPTED_S` at which the errors begin to stay small; infinite for never."""
    far = e.time_s[np.abs(e.position).max(axis=1) > SETTLED_M]
    ends = np.append(far, e.time_s[-1])
    begins = np.append(ADAPTED_S, far)
    calm = np.flatnonzero(ends - begins >= SETTLED_S)
    return float(begins[calm[0]]) - ADAPTED_S if len(calm) else np.inf


def _window(e: StationErrors) -> dict[str, float]:
    out: dict[str, float] = {}
    for i, axis in enumerate(AXES):
        out |= {f'rms_{axis}': rms(e.position[:, i]), f'max_{axis}': largest(e.position[:, i])}
        out |= {
            f'rms_v{axis}': rms(e.velocity_b[:, i]),
            f'max_v{axis}': largest(e.velocity_b[:, i]),
        }
        if len(e.fix):
            out |= {f'rms_fix_{axis}': rms(e.fix[:, i]), f'max_fix_{axis}': largest(e.fix[:, i])}
    if len(e.nis):
        out['nis'] = float(np.mean(e.nis))
    out['nees'] = float(np.mean(e.nees())) / len(AXES)
    return out


def rms(x: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x * x)))


def largest(x: Array) -> float:
    """Largest magnitude."""
    return float(np.abs(x).max())
