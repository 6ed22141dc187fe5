"""What a filter predicts of measurements that it never got: evidence without a truth.

Some measurements are taken out of the inputs before the engine runs; they never enter it. At the
stamp of each one the engine's estimate is compared with it, by the same rows (H, R, z) with which
it would have been fused: the innovation z, and its covariance S = H P H^T + R with the published
covariance P and the measurement's own R.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from polar_nav_core import attitude, earth, grid
from polar_nav_core.arrays import Array
from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.events import Fix
from polar_nav_core.engine.inputs import Inputs
from polar_nav_core.engine.level import is_level
from polar_nav_core.engine.params import EngineParams
from polar_nav_core.engine.track import Track
from polar_nav_core.errors import ConfigError
from polar_nav_core.kernels.sins import rows as kernel_rows

FIXES, DVL, DEPTH = 'fixes', 'dvl', 'depth'
DOF = {FIXES: 3, DVL: 3, DEPTH: 1}
_FORM = re.compile(r'(fixes|dvl|depth):(\d+(?:\.\d+)?)(%|s)')
_ROWS_S = 0.01
"""Time between estimates: those of every IMU sample, so that little is left to interpolate."""


@dataclass(frozen=True)
class Withhold:
    """What is taken out: a share of one kind, chosen at random, or gaps of one length.

    Attributes
    ----------
    kind : {'fixes', 'dvl', 'depth'}
    share : float
        0 where there are gaps.
    gap_s : float
        Gaps begin every two lengths, the first one length after the start; 0 with a share [s].
    """

    kind: str
    share: float = 0.0
    gap_s: float = 0.0

    @property
    def text(self) -> str:
        """As on the command line."""
        amount = f'{100.0 * self.share:g}%' if self.share else f'{self.gap_s:g}s'
        return f'{self.kind}:{amount}'


def parse(text: str) -> Withhold:
    """What a text like ``fixes:50%`` or ``dvl:60s`` takes out; ConfigError for any other."""
    match = _FORM.fullmatch(text)
    amount = float(match[2]) if match is not None else 0.0
    if match is None or amount <= 0.0 or (match[3] == '%' and amount > 100.0):
        raise ConfigError(
            f'--withhold {text}: expected fixes, dvl or depth with a share (fixes:50%) or the '
            'length of gaps (dvl:60s)'
        )
    if match[3] == '%':
        return Withhold(match[1], share=amount / 100.0)
    return Withhold(match[1], gap_s=amount)


@dataclass(frozen=True, eq=False)
class Predicted:
    """Measurements of one kind that were withheld, beside what was predicted of them.

    Attributes
    ----------
    withheld : Withhold
    offered : int
        Usable measurements of this kind in the bag.
    stamp_ns : (n,) array
        Times of validity of those that could be compared.
    error : (n, m) array
        Estimate minus measurement: grid axes, m or m/s; up for a depth.
    covariance : (n, m, m) array
        Of that difference.
    level : (n,) bool array
        Whether it is a fix without a height.
    """

    withheld: Withhold
    offered: int
    stamp_ns: NDArray[np.int64]
    error: Array
    covariance: Array
    level: NDArray[np.bool_]


def withhold(
    params: EngineParams, inputs: Inputs, what: Sequence[Withhold], seed: int
) -> tuple[list[Predicted], str]:
    """Predictions of what was withheld from one run, and the reason if the filter stopped.

    Parameters
    ----------
    params, inputs
        As for `engine.run.run`, of mode sins.
    what : sequence of Withhold
        All taken out of the same run.
    seed : int
        Of the random choice of a share.
    """
    chosen = [_chosen(one, inputs, np.random.default_rng([seed, k])) for k, one in enumerate(what)]
    kept = inputs
    for kind in DOF:
        out = np.zeros(len(_stamps(kind, inputs)), dtype=bool)
        for one, mask in zip(what, chosen, strict=True):
            out |= mask if one.kind == kind else False
        kept = _without(kept, kind, out)
    wanted = np.unique(
        np.concatenate([_stamps(w.kind, inputs)[m] for w, m in zip(what, chosen, strict=True)])
    )
    picker = _Picker(wanted)
    often = replace(params, output_period_s=_ROWS_S)
    result = engine_run.run(often, kept, sink=picker.append)
    compare = _Compare(params, inputs, picker)
    return [
        compare.predicted(one, mask) for one, mask in zip(what, chosen, strict=True)
    ], result.divergence


def _stamps(kind: str, x: Inputs) -> NDArray[np.int64]:
    if kind == FIXES:
        return np.array([fix.validity_ns for fix in x.fixes], dtype=np.int64)
    return x.dvl_stamps_ns if kind == DVL else x.depth_stamps_ns


def _usable(kind: str, x: Inputs) -> NDArray[np.bool_]:
    if kind == FIXES:
        return np.array([f.refusal is None and bool(np.isfinite(f.r_e).all()) for f in x.fixes])
    if kind == DVL:
        return x.dvl_valid & np.isfinite(x.dvl_v_m).all(axis=1)
    return np.isfinite(x.depth)


def _chosen(one: Withhold, x: Inputs, random: np.random.Generator) -> NDArray[np.bool_]:
    """Mask of the measurements of its kind that are taken out, unusable ones in gaps too."""
    stamps = _stamps(one.kind, x)
    if one.gap_s:
        since_s = (stamps - int(x.imu_stamps_ns[0])) * 1e-9
        return np.asarray(np.mod(np.floor(since_s / one.gap_s), 2.0) == 1.0)
    usable = np.flatnonzero(_usable(one.kind, x))
    if one.kind != FIXES:
        mask = np.zeros(len(stamps), dtype=bool)
        mask[random.permutation(usable)[: round(one.share * len(usable))]] = True
        return mask
    # A packet that came twice holds the same fix.
    names = [(f.source, f.sequence, f.validity_ns) for f in x.fixes]
    each = sorted({names[k] for k in usable})
    taken = {each[k] for k in random.permutation(len(each))[: round(one.share * len(each))]}
    return np.array([name in taken for name in names], dtype=bool)


def _without(x: Inputs, kind: str, out: NDArray[np.bool_]) -> Inputs:
    keep = ~out
    if kind == FIXES:
        return replace(x, fixes=tuple(f for f, k in zip(x.fixes, keep, strict=True) if k))
    if kind == DVL:
        return replace(
            x,
            dvl_stamps_ns=x.dvl_stamps_ns[keep],
            dvl_v_m=np.ascontiguousarray(x.dvl_v_m[keep]),
            dvl_covariance_m=np.ascontiguousarray(x.dvl_covariance_m[keep]),
            dvl_valid=x.dvl_valid[keep],
        )
    return replace(
        x,
        depth_stamps_ns=x.depth_stamps_ns[keep],
        depth=x.depth[keep],
        depth_variance=x.depth_variance[keep],
    )


@dataclass(frozen=True)
class _State:
    """Estimate at a stamp."""

    r_e: Array
    v_G: Array
    C_b_G: Array
    P: Array
    sensor_errors: Array


class _Picker:
    """Keeps the rows of a run on either side of the wanted stamps."""

    def __init__(self, wanted_ns: NDArray[np.int64]) -> None:
        self._wanted = wanted_ns
        self._next = 0
        self._last: tuple[int, _State] | None = None
        self._found: dict[int, _State] = {}

    def append(self, chunk: Track) -> None:
        """Take some rows; they are overwritten after the call."""
        stamps = chunk.stamps_ns
        while self._next < len(self._wanted) and self._wanted[self._next] <= stamps[-1]:
            wanted = int(self._wanted[self._next])
            k = int(np.searchsorted(stamps, wanted))
            after = (int(stamps[k]), _row(chunk, k))
            before = (int(stamps[k - 1]), _row(chunk, k - 1)) if k else self._last
            if before is not None or after[0] == wanted:  # else it is before the start
                self._found[wanted] = _between(before or after, after, wanted)
            self._next += 1
        self._last = (int(stamps[-1]), _row(chunk, len(stamps) - 1))

    def at(self, stamp_ns: int) -> _State | None:
        """Estimate at a wanted stamp; None where the run has none."""
        return self._found.get(stamp_ns)


def _row(chunk: Track, k: int) -> _State:
    columns = (chunk.r_e, chunk.v_G, chunk.C_b_G, chunk.P, chunk.sensor_errors)
    return _State(*(column[k].copy() for column in columns))


def _between(before: tuple[int, _State], after: tuple[int, _State], stamp_ns: int) -> _State:
    """State between two estimates; covariance and sensor errors are those before."""
    (a_ns, a), (b_ns, b) = before, after
    share = (stamp_ns - a_ns) / (b_ns - a_ns) if b_ns > a_ns else 1.0
    if share == 1.0:
        return b
    turn = Rotation.from_matrix(a.C_b_G.T @ b.C_b_G).as_rotvec()
    return _State(
        a.r_e + share * (b.r_e - a.r_e),
        a.v_G + share * (b.v_G - a.v_G),
        a.C_b_G @ Rotation.from_rotvec(share * turn).as_matrix(),
        a.P,
        a.sensor_errors,
    )


class _Compare:
    """Rows of measurements at the estimates of a run."""

    def __init__(self, params: EngineParams, inputs: Inputs, picker: _Picker) -> None:
        self._params = params
        self._inputs = inputs
        self._picker = picker
        roll, pitch, yaw = (float(np.radians(a)) for a in params.dvl_rpy_deg)
        self._C_m_b = np.ascontiguousarray(attitude.matrix_from_euler(yaw, pitch, roll))
        self._H, self._R, self._z = np.zeros((3, 24)), np.zeros((3, 3)), np.zeros(3)

    def predicted(self, one: Withhold, mask: NDArray[np.bool_]) -> Predicted:
        """Errors and covariances of the usable ones that were taken out."""
        usable, stamps = _usable(one.kind, self._inputs), _stamps(one.kind, self._inputs)
        fill = {FIXES: self._fix, DVL: self._dvl, DEPTH: self._depth}[one.kind]
        m, found, errors, covariances, level = DOF[one.kind], [], [], [], []
        seen: set[object] = set()
        for k in np.flatnonzero(mask & usable):
            state = self._picker.at(int(stamps[k]))
            name = self._name(one.kind, int(k))
            if state is None or name in seen:
                continue
            seen.add(name)
            fill(int(k), state)
            H, P = self._H[:m], state.P
            found.append(int(stamps[k]))
            errors.append(self._z[:m].copy())
            covariances.append(H @ P @ H.T + self._R[:m, :m])
            level.append(one.kind == FIXES and is_level(self._inputs.fixes[k]))
        return Predicted(
            one,
            len({self._name(one.kind, int(k)) for k in np.flatnonzero(usable)}),
            np.array(found, dtype=np.int64),
            np.array(errors).reshape(-1, m),
            np.array(covariances).reshape(-1, m, m),
            np.array(level, dtype=bool),
        )

    def _name(self, kind: str, k: int) -> object:
        if kind != FIXES:
            return k
        fix = self._inputs.fixes[k]
        return fix.source, fix.sequence, fix.validity_ns

    def _fix(self, k: int, s: _State) -> None:
        fix: Fix = self._inputs.fixes[k]
        C_e_G = np.ascontiguousarray(grid.ecef_to_grid(s.r_e))
        lever_G = s.C_b_G @ np.array(self._params.transponder_lever_b)
        none = np.zeros((3, 3))
        kernel_rows.fix_rows(
            self._H,
            self._R,
            self._z,
            C_e_G,
            lever_G,
            s.r_e + C_e_G.T @ lever_G,
            fix.r_e,
            fix.covariance_e,
            none,
            none[0],
        )

    def _dvl(self, k: int, s: _State) -> None:
        x = self._inputs
        after = int(np.searchsorted(x.imu_stamps_ns, x.dvl_stamps_ns[k], side='right'))
        newest = max(0, after - 1)
        kernel_rows.dvl_rows(
            self._H,
            self._R,
            self._z,
            np.zeros((3, 3)),
            s.C_b_G,
            s.v_G,
            x.omega_ib_b[newest],
            np.asarray(grid.ecef_to_grid(s.r_e)) @ np.array([0.0, 0.0, earth.OMEGA_IE]),
            s.sensor_errors[0:3],
            s.sensor_errors[6:9],
            s.sensor_errors[9:12],
            x.dvl_v_m[k],
            x.dvl_covariance_m[k],
            self._C_m_b,
            np.array(self._params.dvl_lever_b),
        )

    def _depth(self, k: int, s: _State) -> None:
        x, p = self._inputs, self._params
        kernel_rows.depth_rows(
            self._H,
            self._R,
            self._z,
            np.ascontiguousarray(grid.ecef_to_grid(s.r_e)),
            s.C_b_G,
            float(earth.geodetic_from_ecef(s.r_e)[2]),
            p.sea_surface_height - float(x.depth[k]),
            float(x.depth_variance[k]),
            np.array(p.depth_lever_b),
        )
