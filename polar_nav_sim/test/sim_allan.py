"""Records of the simulated IMUs, and their Allan deviations by the package avar.

``python polar_nav_sim/test/sim_allan.py docs/figures`` draws ``imu_allan.svg`` there.
"""

import contextlib
import dataclasses
import functools
import io
import math
import sys
from pathlib import Path

import numpy as np

from polar_nav_sim.randomness import stream
from polar_nav_sim.sensors import presets
from polar_nav_sim.sensors.allan import accel_terms, degrees_of_freedom, deviation, gyro_terms
from polar_nav_sim.sensors.imu import DPH, MICRO_G, ImuErrors, ImuSensor

SEED = 1
COLORS = ('#0072b2', '#56b4e9', '#009e73', '#cc79a7', '#d55e00')
PER_DECADE = 12
HOUR_S = 3600.0
RECORDS = {'1 h at 100 Hz': (0.01, HOUR_S), '10 h at 10 Hz': (0.1, 10.0 * HOUR_S)}
"""Period and length [s]."""
ALL_TERMS = ImuErrors(
    gyro_noise_density=(4e-5,) * 3,
    gyro_instability_sigma_dph=20.0,
    gyro_instability_tau_s=20.0,
    gyro_random_walk=6e-6,
    gyro_quantum=2e-5,
    accel_noise_density=(1e-3,) * 3,
    accel_instability_sigma_ug=300.0,
    accel_instability_tau_s=30.0,
    accel_random_walk=2.5e-4,
    accel_quantum=1e-3,
)
"""No instrument: every term of the model is somewhere the largest one."""


def windows(count):
    """Averaging times as numbers of samples, up to a ninth of the record."""
    steps = math.ceil(PER_DECADE * math.log10(count / 9))
    return np.unique(np.round(np.geomspace(1, count // 9, steps + 1)).astype(int))


def record(errors, period_s, length_s, name, seed=SEED):
    """Rates and forces at rest, shape (6, n)."""
    n = round(length_s / period_s)
    sensor = ImuSensor(errors, period_s, stream(seed, f'allan/{name}'))
    force = np.tile([0.0, 0.0, 9.83 * period_s], (n, 1))
    return np.hstack(sensor.measure(0, np.zeros((n, 3)), force)).T


def measured(y, m):
    """Overlapping Allan deviations, shape (6, len(m)); avar tells its progress on stdout."""
    import avar

    with contextlib.redirect_stdout(io.StringIO()):
        return np.sqrt(avar.variance(np.ascontiguousarray(y), m))


@dataclasses.dataclass(frozen=True)
class Comparison:
    """One record: averaging times, and by axis (three gyros, three accelerometers) the rest."""

    tau_s: np.ndarray
    measured: np.ndarray
    expected: np.ndarray
    dof: np.ndarray

    @property
    def sigmas(self):
        """Deviation from the expected curve over the 1-sigma of the estimate."""
        return (self.measured / self.expected - 1.0) * np.sqrt(2.0 * self.dof)


def terms_of(errors):
    return [f(errors, axis) for f in (gyro_terms, accel_terms) for axis in range(3)]


def compare(errors, period_s, length_s, name, seed=SEED):
    y = record(errors, period_s, length_s, name, seed)
    m = windows(y.shape[1])
    terms = terms_of(errors)
    dof = {t: degrees_of_freedom(t, period_s, m, y.shape[1]) for t in set(terms)}
    return Comparison(
        m * period_s,
        measured(y, m),
        np.array([deviation(t, period_s, m) for t in terms]),
        np.array([dof[t] for t in terms]),
    )


@functools.cache
def preset(name, length):
    return compare(presets.IMU[name].errors, *RECORDS[length], f'{name}/{length}')


@functools.cache
def all_terms():
    return compare(ALL_TERMS, 0.1, HOUR_S, 'all')


def draw(folder):
    """RMS over the three axes of every preset, its curve and its 3-sigma band; both lengths."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    mpl.rcParams.update({'svg.hashsalt': 'polar_nav', 'font.size': 9})
    fig = Figure(figsize=(9.0, 4.6), layout='constrained')
    halves = (('gyro [deg/h]', 1.0 / DPH, 0), ('accelerometer [1e-6 g0]', 1.0 / MICRO_G, 3))
    for ax, (title, unit, first) in zip(fig.subplots(1, 2), halves, strict=True):
        rows = slice(first, first + 3)
        for color, name in zip(COLORS, presets.IMU, strict=True):
            for length, marker in zip(RECORDS, 'o^', strict=True):
                c = preset(name, length)
                curve = unit * np.sqrt(np.mean(c.expected[rows] ** 2, axis=0))
                spread = 3.0 / np.sqrt(2.0 * c.dof[rows].min(axis=0))
                points = unit * np.sqrt(np.mean(c.measured[rows] ** 2, axis=0))
                low = curve * np.maximum(1.0 - spread, 0.05)
                ax.fill_between(
                    c.tau_s, low, curve * (1.0 + spread), color=color, alpha=0.15, lw=0
                )
                ax.loglog(c.tau_s, curve, color=color, lw=0.8)
                label = name if marker == 'o' else None
                ax.plot(c.tau_s, points, marker, ms=2.5, color=color, label=label)
        ax.set_title(f'Allan deviation, {title}', fontsize=9)
        ax.set_xlabel('averaging time [s]')
        ax.grid(visible=True, which='major', lw=0.3)
    ax.legend(loc='lower left', frameon=False)
    fig.savefig(folder / 'imu_allan.svg', metadata={'Date': None})


if __name__ == '__main__':
    draw(Path(sys.argv[1]))
