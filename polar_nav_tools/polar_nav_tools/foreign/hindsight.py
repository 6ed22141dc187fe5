"""What a run itself says of its mapping: measurements that do not fit the IMU, and what would.

Axes, lever arms and offsets of a DVL or of fixes cannot be seen in their numbers alone. When the
filter refuses them, or their NIS is far from what was stated, that is told. For a DVL the other
axes that have a name are tried on the first minutes, and those of a level instrument turned by 45
degrees, as many are mounted; each with the noise of the IMU as stated, 10 and 100 times as large.
Its lever arm and latency are looked for in the turns, refused or not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.outputs import LOCAL_DOF, NIS_SUM, UPDATES, Receipt
from polar_nav_core.engine.verdicts import Verdict
from polar_nav_follower.params import FollowerParams
from polar_nav_ros.adapters import rotations

from ..bags.finding import Finding, Severity
from .findings import finding
from .load import Loaded
from .turns import Turns, turns

_FEWEST = 20
_FEWEST_FIXES = 4
_REFUSED = 0.05
"""Share of pings or depths that are refused; the gate refuses one in ten thousand good ones."""
_REFUSED_FIXES = 0.5
_NIS = 3.0
"""Mean NIS over its degrees of freedom; 1 is what was stated."""
_TRIED_NS = 300_000_000_000
_BETTER = 3.0
"""By how much other axes must fit better to be told."""
_FITS = 1.5
"""Mean NIS over its degrees of freedom at which nothing else is looked for."""
_FACTORS = (10.0, 100.0)
_IMU_NOISE = {
    'gyro_bias_sigma': 1.0,
    'gyro_noise_density': 1.0,
    'gyro_bias_walk': 1.0,
    'accel_bias_sigma': 10.0,
    'accel_noise_density': 10.0,
    'accel_bias_walk': 10.0,
}
"""Parameters that are tried larger, with their upper limits."""
_SIGMAS = 5.0
_LEVER_M, _LAG_S = 0.2, 0.1
"""Less than this in lever arm or latency is what a person may well leave out."""


BEYOND = 'does not fit the run, beyond the limits'


def is_misfit(found: Finding) -> bool:
    """Whether a finding is of measurements that do not fit the run, beyond their limits."""
    return found.name.endswith('_misfit')


def look_back(
    loaded: Loaded, params: FollowerParams, statistics: Array, receipts: Sequence[Receipt]
) -> tuple[Finding, ...]:
    """Say what did not fit.

    Parameters
    ----------
    loaded : Loaded
    params : FollowerParams
        As the engine ran with.
    statistics : (2, 3) array
        Local statistics of the run (`outputs.LOCAL_DOF`).
    receipts : sequence of Receipt
    """
    if params.mode != 'sins':
        return ()
    dvl = list(_dvl(loaded, params, statistics[0]))
    before = 'put the DVL right first; then ' if dvl else ''
    return (*dvl, *_depth(loaded, statistics[1], before), *_fixes(loaded, receipts, before))


def _misfit(row: Array, dof: int) -> tuple[int, float, float] | None:
    """Measurements, share refused, NIS over its degrees of freedom; None where all fit."""
    used, refused, nis = (float(v) for v in row)
    n = used + refused
    if n < _FEWEST:
        return None
    share, ratio = refused / n, nis / max(used, 1.0) / dof
    return None if share <= _REFUSED and ratio <= _NIS else (int(n), share, ratio)


def _said(share: float, ratio: float) -> str:
    others = f', NIS of the others is {ratio:.3g} times its expectation (limit {_NIS:g})'
    return (
        f'{100.0 * share:.3g} % were refused by the gate (limit {100.0 * _REFUSED:g} %)'
        f'{others if share < 1.0 else ""}'
    )


def _turns(topic: str, seen: Turns | None) -> Iterator[Finding]:
    """Lever arm and latency that the turns show, where they are large and certain."""
    if seen is None:
        return
    levers = list(zip('xy', seen.lever_b, seen.lever_sigma, strict=True))
    off = [x for x in levers if abs(x[1]) > max(_LEVER_M, _SIGMAS * x[2])]
    late = abs(seen.lag_s) > max(_LAG_S, _SIGMAS * seen.lag_sigma)
    if not off and not late:
        return
    said = [
        f'`lever_b` {axis} is {value:+.2f} m off (1-sigma {sigma:.2f} m)'
        for axis, value, sigma in off
    ]
    if late:
        said.append(
            f'pings are {seen.lag_s:.2f} s old at their stamps (1-sigma {seen.lag_sigma:.2f} s), '
            f'add {-seen.lag_s:.2f} to `time_offset_s`'
        )
    if off and off[0][0] == 'x' and not late:
        # Lateral velocity by yaw rate: of a point, or of a velocity held in axes that do not turn.
        same = off[0][1] / max(seen.speed, 1e-6)
        said.append(
            f'at {seen.speed:.2g} m/s a velocity whose direction is {abs(same):.2f} s '
            f'{"early" if same < 0.0 else "late"} looks the same'
        )
    yield finding(
        'dvl_lever',
        Severity.WARNING,
        topic,
        None,
        seen.windows,
        float(off[0][1]) if off else seen.lag_s,
        f'in {seen.windows} windows of 20 s with turns, {"; ".join(said)}',
    )


def _dvl(loaded: Loaded, params: FollowerParams, row: Array) -> Iterator[Finding]:
    mapping = loaded.mapping.dvl
    if mapping is None:
        return
    topic = mapping.stream.topic
    found = _misfit(row, LOCAL_DOF['dvl'])
    lever = list(_turns(topic, turns(loaded.inputs, np.asarray(params.dvl_lever_b))))
    if found is None and not lever:
        return
    trial = tried_axes(loaded, params)
    if _turned(trial):  # of a DVL in other axes no turn says where it is
        lever = []
    yield from lever
    if found is None:
        return
    n, share, ratio = found
    yield finding(
        'dvl_misfit',
        Severity.WARNING,
        topic,
        None,
        n,
        max(share, ratio),
        f'pings do not fit the IMU: {_said(share, ratio)}. '
        f'{_advice(loaded, params, trial, bool(lever))}',
    )


_Trial = tuple[float, dict[str, float]]
"""Mean NIS of the DVL with the axes stated, and with others by name."""


def _best(trial: _Trial) -> str:
    return min(trial[1], key=lambda rotation: trial[1][rotation])


def _turned(trial: _Trial) -> bool:
    """Whether other axes fit so much better that those stated are wrong."""
    return _BETTER * trial[1][_best(trial)] < trial[0]


def _axes_text(trial: _Trial) -> str:
    best = _best(trial)
    times = trial[0] / trial[1][best]
    return f'`rotation: {best}` fits {times:.3g} times better in the first minutes'


def _advice(loaded: Loaded, params: FollowerParams, trial: _Trial, lever: bool) -> str:
    """Return what makes the DVL fit: other axes, a lever arm, more noise of the IMU, or nothing.

    Parameters
    ----------
    loaded, params
    trial : _Trial
        With the noise of the IMU as stated.
    lever : bool
        Whether the turns show a lever arm or a latency.
    """
    turned = _turned(trial)
    if lever:
        return 'See the lever arm or latency that the turns show (dvl_lever)'
    dof = LOCAL_DOF['dvl']
    fits = (trial[1][_best(trial)] if turned else trial[0]) <= _FITS * dof
    if not fits:
        for factor in _FACTORS:
            other = tried_axes(loaded, with_imu_noise(params, factor))
            ratio = other[1][_best(other)] if _turned(other) else other[0]
            if ratio <= _FITS * dof:
                axes = f'; {_axes_text(other)}' if _turned(other) else ''
                return (
                    f'With the noise of the IMU {factor:g} times as large, all six parameters, '
                    f'they fit (NIS {ratio / dof:.2g} times its expectation in the first '
                    f'minutes{axes}): see `noise`, and the class of the IMU'
                )
    if turned:
        return f'See `rotation` first: {_axes_text(trial)}'
    noise = '' if fits else ', nor a noise of the IMU up to 100 times as large'
    return (
        'See `rotation` first: no other axes along those of the body fit better, nor turned by 45 '
        f'degrees{noise}: lever_b of DVL and IMU, time_offset_s, sigma, or other angles'
    )


def with_imu_noise(params: FollowerParams, factor: float) -> FollowerParams:
    """Return the parameters with the six of the IMU's noise so many times as large."""
    changes = {n: min(getattr(params, n) * factor, most) for n, most in _IMU_NOISE.items()}
    return replace(params, **changes)


def tried_axes(loaded: Loaded, params: FollowerParams) -> _Trial:
    """Mean NIS of the DVL in the first minutes: with the axes stated, and with others.

    Those are named as in a mapping. Without gate and without fixes: how well the DVL goes with
    the IMU alone.
    """
    x, mapping = loaded.inputs, loaded.mapping.dvl
    if mapping is None:
        return float('nan'), {}
    until_ns = int(x.imu_stamps_ns[0]) + _TRIED_NS
    i, d, e = (
        int(np.searchsorted(stamps, until_ns))
        for stamps in (x.imu_stamps_ns, x.dvl_stamps_ns, x.depth_stamps_ns)
    )
    first = Inputs(
        x.imu_stamps_ns[:i],
        x.omega_ib_b[:i],
        x.f_b[:i],
        dvl_stamps_ns=x.dvl_stamps_ns[:d],
        dvl_v_m=x.dvl_v_m[:d],
        dvl_covariance_m=x.dvl_covariance_m[:d],
        dvl_valid=x.dvl_valid[:d],
        depth_stamps_ns=x.depth_stamps_ns[:e],
        depth=x.depth[:e],
        depth_variance=x.depth_variance[:e],
    )
    open_ = replace(
        params,
        configuration='custom',
        delay_handling='ignore',
        noise_adaptation='none',
        gate_probability=1.0,
    )

    def nis(turn: Array) -> float:
        inputs = replace(
            first,
            dvl_v_m=np.ascontiguousarray(first.dvl_v_m @ turn.T),
            dvl_covariance_m=np.ascontiguousarray(turn @ first.dvl_covariance_m @ turn.T),
        )
        rows: list[Array] = []
        result = engine_run.run(
            open_, inputs, sink=lambda chunk: rows.append(chunk.local_statistics.sum(axis=0))
        )
        total = np.sum(rows, axis=0)[0] if rows else np.zeros(3)
        if result.divergence or not total[UPDATES]:
            return float('inf')
        return float(total[NIS_SUM] / total[UPDATES])

    back = mapping.C_s_b.T
    return nis(np.eye(3)), {name: nis(C @ back) for name, C in _axes().items()}


def _axes() -> dict[str, Array]:
    found = rotations.all_named()
    for rpy_deg in ((roll, 0, yaw) for roll in (0, 180) for yaw in (45, 135, -135, -45)):
        found[f'{{rpy_deg: {list(rpy_deg)}}}'] = rotations.from_rpy_deg(rpy_deg)
    return found


def _depth(loaded: Loaded, row: Array, before: str) -> Iterator[Finding]:
    found = _misfit(row, LOCAL_DOF['depth'])
    mapping = loaded.mapping.depth
    if found is None or mapping is None:
        return
    n, share, ratio = found
    p = loaded.params
    yield finding(
        'depth_misfit',
        Severity.WARNING,
        mapping.stream.topic,
        None,
        n,
        max(share, ratio),
        f'depths do not fit: {_said(share, ratio)}. By the start the depth is '
        f'{p.sea_surface_height - p.initial_height:.2f} m, the first that was measured is '
        f'{loaded.inputs.depth[0]:.2f} m: {before}see unit, positive, lever_b, sea_surface_height '
        'among parameters (heights are above the ellipsoid, the sea need not be at zero)',
    )


def _fixes(loaded: Loaded, receipts: Sequence[Receipt], before: str) -> Iterator[Finding]:
    fixes = [r for r in receipts if r.topic in {f.topic for f in loaded.inputs.fixes}]
    refused = [r for r in fixes if r.verdict is Verdict.GATED]
    if len(fixes) < _FEWEST_FIXES or len(refused) <= _REFUSED_FIXES * len(fixes):
        return
    off = float(np.median([np.linalg.norm(r.innovation_G[:2]) for r in refused]))
    stated = float(np.median([np.sqrt(np.sum(r.innovation_variance_G[:2])) for r in refused]))
    yield finding(
        'fixes_misfit',
        Severity.WARNING,
        refused[0].topic,
        refused[0].stamp_ns,
        len(refused),
        off,
        f'{len(refused)} of {len(fixes)} fixes were refused by the gate: they are {off:.3g} m '
        f'off, where {stated:.3g} m are expected (medians, horizontal): {before}see frame and '
        'origin, time_offset_s, transponder_lever_b and sigma of the fixes, and the heading and '
        'the noise that were stated',
    )
