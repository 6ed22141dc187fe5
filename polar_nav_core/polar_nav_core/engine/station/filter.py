"""State of station mode at one stamp: a bank of augmented filters, compiled.

Events come in order. The compiled code (kernels.station.run) does the work; this class holds the
arrays, starts them and turns the state into estimates.
"""

from __future__ import annotations

import math

import numpy as np

from ... import earth, grid
from ...arrays import Array
from ...errors import FilterDivergence
from ...identification.result import Identification
from ...kernels.station import run
from ...kernels.station import state as ss
from ...kernels.station.attitude import smooth
from ...kernels.vehicle import model as vm
from ...order import NEVER_NS
from ..events import ControlSample, DepthSample, ImuSample, InitialState
from ..outputs import Estimate, ModelEstimate
from ..params import EngineParams
from ..plausibility import MOST_VARIANCE
from ..results import Outcome
from ..saved import SavedState
from . import arrays
from .resume import resume, save_state

_NOT_DEFINITE = 'a variance of the filter is not positive and finite'
_ENLARGED = 4.0
"""Factor on the variances of a state that is restored."""
_LOST_ACCELERATION = 0.5
"""What the vehicle may have done since [m/s^2]; the AHRS knows how it has turned."""
_SAMPLES = 3
"""Of the AHRS, that the next step looks back to."""
_IDENTIFIED = ('drag_linear', 'drag_quadratic', 'current_x', 'current_y', 'heading_bias')


class StationFilter:
    """Bank of compiled filters on the state of `kernels.station.state`.

    Parameters
    ----------
    params : EngineParams
    initial : InitialState
        Position and velocity through the water with their 1-sigma; attitude is the AHRS'.
    stamp_ns : int
    snapshots, jumps : bool
        What is stored for late fixes: states to go back to, corrections to bring a fix forward.
    """

    def __init__(
        self,
        params: EngineParams,
        initial: InitialState,
        stamp_ns: int,
        *,
        snapshots: bool = False,
        jumps: bool = False,
    ) -> None:
        self._p = params
        self._initial = initial
        self.settings = arrays.make_settings(params)
        members = len(self.settings.q_current)
        self.bank = arrays.make_bank(members)
        self.work = arrays.make_work(members)
        self.streams = arrays.live_streams(params.history_s, members)
        self.log = arrays.make_log(params.history_s, members, snapshots=snapshots, jumps=jumps)
        self.rows = self.no_rows = arrays.make_rows(0, members)
        self.row = arrays.make_rows(1, members)
        self.bank.counters[ss.STAMP] = stamp_ns
        self.begun = 0
        """Number of the first IMU sample with a stored past."""

    # -- events -----------------------------------------------------------------------------------

    def begin(self, sample: ImuSample) -> None:
        """Start at the sample at the stamp of the initial state, with its attitude."""
        self.put_imu(sample)
        self.bank.counters[ss.IMU] = 1
        C_b_G = np.asarray(sample.C_b_G)
        if isinstance(self._initial, SavedState):
            resume(self.bank, self.settings, C_b_G, self._initial, sample.stamp_ns)
        else:
            self._set_state(C_b_G)
        run.start(self.bank, self.settings, self.work, self.log)

    def _set_state(self, C_b_G: Array) -> None:
        """Set the initial state; its velocity is that through the water: current unknown."""
        p, s, c = self._p, self._initial, self.settings
        r_e = np.asarray(earth.ecef_from_geodetic(s.latitude, s.longitude, s.height))
        C_e_G = grid.ecef_to_grid(r_e)
        C_G_A = np.einsum('ij,kj->ik', c.C_e_A, C_e_G)
        R = np.einsum('ij,jk->ik', C_G_A, C_b_G)
        x = np.zeros(ss.N)
        x[ss.V_R : ss.POSITION] = np.einsum('ji,jk,k->i', R, C_G_A, np.array(s.v_G))
        x[ss.POSITION : ss.CURRENT] = np.einsum('ij,j->i', c.C_e_A, r_e - c.origin_e)
        x[ss.DRAG], x[ss.SHARE] = p.vehicle_model().logarithmic_drag(p.model_speed)
        variances = np.zeros(ss.N)
        variances[ss.V_R : ss.POSITION] = s.sigma_velocity**2
        variances[ss.HORIZONTAL] = s.sigma_position_horizontal**2
        variances[ss.POSITION + 2] = s.sigma_position_vertical**2
        variances[ss.CURRENT : ss.DRAG] = p.current_sigma**2
        if c.published:
            x[ss.CURRENT : ss.DRAG] = p.published_current
        variances[ss.DRAG] = p.model_drag_sigma**2
        variances[ss.SHARE] = p.model_share_sigma**2
        variances[ss.HEADING] = math.radians(p.station_heading_bias_sigma_deg) ** 2
        if c.published:
            variances[ss.DYNAMIC :] = 0.0
        self.bank.x[:] = x
        self.bank.P[:] = np.diag(variances)

    def restore(self, lost: StationFilter) -> None:
        """Begin at the newest IMU sample with the newest sound state of a lost filter, enlarged.

        Correlations are dropped: they may be what was lost.
        """
        b, good = self.bank, lost.log.good
        now_ns = self.stamp_ns
        since_s = max(0.0, (now_ns - int(good.counters[ss.STAMP])) * 1e-9)
        b.x[:], b.weight[:], b.log_weight[:] = good.x, good.weight, good.log_weight
        b.flat[:] = good.flat
        b.counters[:] = lost.bank.counters
        C_b_A = self._continue_streams(lost, now_ns)
        v_A = np.einsum('ij,mj->mi', C_b_A, b.x[:, ss.V_R : ss.POSITION])
        if not self.settings.published:
            v_A[:, :2] += b.x[:, ss.CURRENT : ss.DRAG]
        b.x[:, ss.POSITION : ss.CURRENT] += since_s * v_A
        variance = np.minimum(_ENLARGED * np.diagonal(good.P, axis1=1, axis2=2), MOST_VARIANCE)
        b.P[:] = 0.0
        for P, own, v in zip(b.P, variance, v_A, strict=True):
            slower = _LOST_ACCELERATION * since_s
            way = (float(np.linalg.norm(v)) + slower) * since_s
            own[ss.V_R : ss.POSITION] += slower**2
            own[ss.POSITION : ss.CURRENT] += way**2
            np.fill_diagonal(P, own)
        run.start(b, self.settings, self.work, self.log)

    def _continue_streams(self, lost: StationFilter, now_ns: int) -> Array:
        """Copy the newest samples of a lost filter under their numbers; returns C_b_A then."""
        old, new, counters = lost.streams, self.streams, self.bank.counters
        count = int(old.counts[0])
        n = len(old.imu_stamps)
        while count > 1 and old.imu_stamps[(count - 1) % n] > now_ns:  # a whole run has them all
            count -= 1
        self.begun = count - 1
        for number in range(max(0, count - _SAMPLES), count):
            i, k = number % n, number % len(new.imu_stamps)
            new.imu_stamps[k] = old.imu_stamps[i]
            new.omega_ib_b[k] = old.omega_ib_b[i]
            new.C_b_G[k] = old.C_b_G[i]
            new.unexplained[k] = old.unexplained[i]
        new.counts[0] = counters[ss.IMU] = count
        counters[ss.STAMP] = now_ns
        counters[[ss.CONTROL, ss.DEPTH, ss.FIX, ss.RUN]] = 0
        axes = self.bank.flat[ss.AXES : ss.AXES + 9].reshape(3, 3)
        return np.asarray(axes.T @ old.C_b_G[(count - 1) % n])

    def advance(
        self, until_ns: int = NEVER_NS, until_rank: int = 0, *, frozen: bool = False
    ) -> int:
        """Process the samples in the streams that come before a stamp [ns] and rank.

        Raises
        ------
        FilterDivergence
            When a variance is not positive or the state not finite.
        """
        code = int(
            run.advance(
                self.bank,
                self.settings,
                self.work,
                self.streams,
                self.log,
                until_ns,
                until_rank,
                frozen,
                self.rows,
            )
        )
        if code == ss.NOT_DEFINITE:
            raise FilterDivergence(_NOT_DEFINITE)
        return code

    def check(self) -> None:
        """Raise FilterDivergence when a variance is not positive or the state not finite."""
        if not run.healthy(self.bank, self.settings):
            raise FilterDivergence(_NOT_DEFINITE)

    def put_imu(self, sample: ImuSample) -> None:
        """Append an IMU sample to its stream."""
        s = self.streams
        i = s.counts[0] % len(s.imu_stamps)
        s.imu_stamps[i] = sample.stamp_ns
        s.omega_ib_b[i] = sample.omega_ib_b
        s.C_b_G[i] = sample.C_b_G
        s.counts[0] += 1
        self.smooth(int(s.counts[0]) - 1)

    def smooth(self, first: int) -> None:
        """Smooth the attitudes in the stream from an index on, in place."""
        s, c = self.streams, self.settings
        smooth(
            s.imu_stamps,
            s.omega_ib_b,
            s.C_b_G,
            s.unexplained,
            first,
            int(s.counts[0]),
            c.attitude_tau,
            c.omega_ie_A,
        )

    def imu(self, sample: ImuSample) -> None:
        """Advance to the sample's stamp."""
        self.put_imu(sample)
        self.advance()

    def control(self, sample: ControlSample) -> None:
        """Append the thrust that holds from its stamp on."""
        s = self.streams
        i = s.counts[1] % len(s.control_stamps)
        s.control_stamps[i] = sample.stamp_ns
        s.force_b[i] = sample.force_b
        s.counts[1] += 1

    def depth(self, sample: DepthSample) -> Outcome:
        """Fuse one depth; returns the outcome."""
        s = self.streams
        i = s.counts[2] % len(s.depth_stamps)
        s.depth_stamps[i] = sample.stamp_ns
        s.depth[i] = sample.depth
        s.depth_variance[i] = sample.variance
        s.counts[2] += 1
        self.advance()
        nis, innovation, variance, fused = self.work.nis
        z, var = np.full(3, np.nan), np.full(3, np.nan)
        z[0], var[0] = -innovation, variance
        return Outcome(bool(fused), z, var, float(nis), 1, float(self.settings.gates[1]))

    def adapt(self, identified: Identification) -> None:
        """Replace drag and current by identified ones; the published filter treats them as known.

        The augmented one starts these states anew with the covariance that came with them, and
        with no correlation to the others.
        """
        b, c = self.bank, self.settings
        names = [name for name in _IDENTIFIED if name in identified.names]
        wanted = [identified.names.index(name) for name in names]
        d1, d2, *others = identified.values[wanted].tolist()
        total = (d1 + d2 * c.speed) * c.speed
        share = d2 * c.speed**2 / total
        states = [ss.DRAG, ss.SHARE, ss.CURRENT, ss.CURRENT + 1, ss.HEADING][: len(names)]
        if c.published:
            states, others = states[:4], others[:2]
        b.x[:, states] = [math.log(total), share, *others]
        if c.published:
            return
        J = np.eye(len(names))
        J[0, :2] = np.array([c.speed, c.speed**2]) / total
        J[1, :2] = np.array([-share * c.speed, (1.0 - share) * c.speed**2]) / total
        covariance = identified.covariance[np.ix_(wanted, wanted)]
        b.P[:, states, :] = 0.0
        b.P[:, :, states] = 0.0
        for P in b.P:
            P[np.ix_(states, states)] = np.einsum('ij,jk,lk->il', J, covariance, J)
        run.start(b, c, self.work, self.log)

    # -- what is known ----------------------------------------------------------------------------

    def saved(self, fixes: tuple[int, int, int], records: tuple[bytes, bytes]) -> SavedState:
        """State as it is now, with its fixes, to go on from after a restart."""
        s = self.streams
        C_b_G = s.C_b_G[(s.counts[0] - 1) % len(s.imu_stamps)]
        return save_state(self.bank, self.settings, C_b_G, self.mixture()[0], fixes, records)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest IMU sample."""
        return int(self.bank.counters[ss.STAMP])

    def mixture(self) -> tuple[Array, Array]:
        """Mean (12,) and covariance (12, 12) of the bank."""
        b = self.bank
        mean = np.einsum('m,mi->i', b.weight, b.x)
        off = b.x - mean
        P = np.einsum('m,mij->ij', b.weight, b.P) + np.einsum('m,mi,mj->ij', b.weight, off, off)
        return mean, P

    def published_mixture(self) -> tuple[Array, Array]:
        """Mean (12,) and covariance (12, 12) of the bank, with the common errors."""
        mean, P = self.mixture()
        S = np.einsum('m,mik->ik', self.bank.weight, self.bank.S) * self.settings.common
        return mean, P + np.einsum('ik,jk->ij', S, S)

    def estimate(self, fixes: tuple[int, int, int]) -> Estimate:
        """Estimate at the newest IMU sample, with the local statistics since the last estimate."""
        self.row.io[1] = 0
        run.put_row(self.bank, self.settings, self.work, self.streams, self.row)
        return estimate_of(self.row, 0, fixes, self._p.model_speed)


def estimate_of(rows: ss.Rows, k: int, fixes: tuple[int, int, int], speed: float) -> Estimate:
    """Estimate of output row k; ``fixes`` are received, fused, newest validity [ns]."""
    nothing = np.full(3, np.nan)
    P = np.full((24, 24), np.nan)
    P[:9, :9] = rows.P[k]
    return Estimate(
        stamp_ns=int(rows.stamps[k]),
        r_e=rows.r_e[k].copy(),
        v_G=rows.v_G[k].copy(),
        C_b_G=rows.C_b_G[k].copy(),
        P=P,
        gyro_bias_b=nothing,
        accel_bias_b=nothing,
        dvl_scale_m=nothing,
        dvl_markov_m=nothing,
        usbl_bias_a=nothing,
        fixes_received=fixes[0],
        fixes_fused=fixes[1],
        last_validity_ns=fixes[2],
        local_statistics=rows.tally[k].copy(),
        model=model_of(rows.x[k], rows.P_x[k], float(rows.walk[k]), speed),
    )


def model_of(x: Array, P: Array, walk: float, speed: float) -> ModelEstimate:
    """Estimated drag and current from the state (12,) and its covariance (12, 12)."""
    d1, d2 = vm.surge_drag(float(x[ss.DRAG]), float(x[ss.SHARE]), speed)
    total = math.exp(x[ss.DRAG])
    J = np.array([[d1, -total / speed], [d2, total / speed**2]])
    drag = slice(ss.DRAG, ss.SHARE + 1)
    D = np.einsum('ai,ij,bj->ab', J, P[drag, drag], J)
    current = np.full((3, 3), np.nan)
    current[:2, :2] = P[ss.CURRENT : ss.DRAG, ss.CURRENT : ss.DRAG]
    s1, s2 = math.sqrt(D[0, 0]), math.sqrt(D[1, 1])  # NaN where it is not estimated
    return ModelEstimate(
        v_r_b=x[:3].copy(),
        v_r_covariance_b=P[:3, :3].copy(),
        current_G=np.array([x[ss.CURRENT], x[ss.CURRENT + 1], 0.0]),
        current_covariance_G=current,
        drag_linear=d1,
        drag_linear_sigma=s1,
        drag_quadratic=d2,
        drag_quadratic_sigma=s2,
        drag_correlation=float(D[0, 1]) / (s1 * s2),
        heading_bias=float(x[ss.HEADING]),
        heading_bias_sigma=math.sqrt(P[ss.HEADING, ss.HEADING]),
        current_walk=walk,
    )
