"""Example input of a report with a made-up model of water and drag."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..scoring.compare import Run
from ..series.model import Identified, ModelRun, ModelSeries
from ..series.vehicle import Ints
from .example import example_input
from .input import ReportInput

_CURRENT = (0.4, 0.25)
_DRAG = (25.0, 19.0)
_BIAS = 0.03


def example_with_model(*, minutes: float = 10.0, seed: int = 1) -> ReportInput:
    """Both configurations of the made-up mission, each with its estimates of the water."""
    data = example_input(minutes=minutes, seed=seed)
    rng = np.random.default_rng(seed)
    runs: dict[str, Run] = {}
    models = {}
    for name, (truth, estimate, receipts) in data.runs.items():
        current_G = np.tile([*_CURRENT, 0.0], (len(truth), 1))
        runs[name] = (dataclasses.replace(truth, current_G=current_G), estimate, receipts)
        models[name] = _model(estimate.stamp_ns[::10], rng)
    return dataclasses.replace(data, runs=runs, models=models)


def _model(stamp_ns: Ints, rng: np.random.Generator) -> ModelRun:
    n = len(stamp_ns)
    fade = np.exp(-np.arange(n) / (0.15 * n))

    def learnt(start: float, end: float, count: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Errors and their sigma, shapes (n, count) and (n,): large at first, then small."""
        sigma = end + (start - end) * fade
        walk = (
            np.cumsum(rng.standard_normal((n, count)), axis=0)
            / np.sqrt(np.arange(1, n + 1))[:, None]
        )
        return walk * sigma[:, None], sigma

    current, sigma_c = learnt(0.4, 0.012, 2)
    drag, sigma_d = learnt(20.0, 3.0)
    bias, sigma_b = learnt(0.03, 0.004)
    P = np.zeros((n, 3, 3))
    P[:, 0, 0] = P[:, 1, 1] = sigma_c**2
    P[:, 0, 1] = P[:, 1, 0] = 0.5 * sigma_c**2
    zero, one = np.zeros(n), np.ones(n)
    v_r_b = np.tile([1.1, 0.0, 0.0], (n, 1))
    estimated = ModelSeries(
        stamp_ns=stamp_ns,
        v_r_b=v_r_b,
        P_v_r_b=np.tile(1e-4 * np.eye(3), (n, 1, 1)),
        current_G=np.column_stack(
            [_CURRENT[0] + current[:, 0], _CURRENT[1] + current[:, 1], zero]
        ),
        P_current_G=P,
        drag_linear=_DRAG[0] + drag[:, 0],
        drag_linear_sigma=sigma_d,
        drag_quadratic=_DRAG[1] - 0.9 * drag[:, 0],
        drag_quadratic_sigma=0.9 * sigma_d,
        drag_correlation=-0.99 * one,
        heading_bias=_BIAS + bias[:, 0],
        heading_bias_sigma=sigma_b,
        current_walk=1e-6 * one,
    )
    truth = dataclasses.replace(
        estimated,
        current_G=np.tile([*_CURRENT, 0.0], (n, 1)),
        P_current_G=np.zeros((n, 3, 3)),
        P_v_r_b=np.zeros((n, 3, 3)),
        drag_linear=_DRAG[0] * one,
        drag_quadratic=_DRAG[1] * one,
        heading_bias=_BIAS * one,
        drag_linear_sigma=zero,
        drag_quadratic_sigma=zero,
        drag_correlation=zero,
        current_walk=zero,
        heading_bias_sigma=zero,
    )
    found = (_identified(stamp_ns, 0.3, 'NOT_EXCITED'), _identified(stamp_ns, 0.6, 'ACCEPTED'))
    return ModelRun(estimated, found, truth)


def _identified(stamp_ns: Ints, share: float, verdict: str) -> Identified:
    return Identified(
        stamp_ns=int(stamp_ns[int(share * len(stamp_ns))]),
        method='robust',
        verdict=verdict,
        reason='made up',
        trigger='count',
        fixes=120,
        values={
            'drag_linear': 27.0,
            'drag_quadratic': 17.0,
            'current_x': 0.395,
            'current_y': 0.247,
            'heading_bias': 0.028,
        },
        sigmas={
            'drag_linear': 2.9,
            'drag_quadratic': 2.5,
            'current_x': 0.004,
            'current_y': 0.004,
            'heading_bias': 0.004,
        },
        condition_number=1e4,
        cost=118.0,
        iterations=9,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the report of a made-up mission."""
    from .write import write_report

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('path', type=Path)
    options = parser.parse_args(arguments)
    write_report(options.path, example_with_model())
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
