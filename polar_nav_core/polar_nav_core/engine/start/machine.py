"""The start of a navigation as a machine: events in, an initial state out, or what it waits for.

Pure: it owns no clock. A node feeds it events as they come, and records the state that it finds
as a command (nav/command), so that a replay starts from the same one; a replay of a recording that
has no such command feeds it the recorded events.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...attitude import matrix_from_euler
from ...earth import OMEGA_IE, ecef_from_geodetic
from ...grid import convergence, ecef_to_grid
from ..events import DepthSample, DvlPing, Event, Fix, HeadingSample, ImuSample, InitialState
from ..params import EngineParams
from ..plausibility import initial_problem, is_covariance, is_variance, within
from .course import course
from .gyrocompass import UNKNOWN_SPEED, gyrocompass
from .headings import Headings
from .level import GRAVITY, LevelFrame
from .model import MOST_HEADING, SAME_AGAIN, Aligned, Candidate, Phase, Progress, Stated
from .north import North, convergence_sigma, north_of
from .place import UNKNOWN_VELOCITY, Fixes, Place, geodetic

_SECOND_NS = 1_000_000_000
_FRESH_S = 1.0
_DEPTH_FRESH_S = 5.0
_AT_SURFACE = 10.0
"""1-sigma of a height that nothing states or measures: the vehicle is at the surface [m]."""
_LEAST_WAY = 1.0


class Start:
    """Finds an initial state from events.

    Parameters
    ----------
    params : EngineParams
    stated : Stated
        Parts that need not be found.
    inputs : frozenset of str
        Of ``fix``, ``dvl``, ``depth``, ``heading``: what the vehicle has sources of; ``position``
        where the place is stated by and by (`restate`).
    """

    def __init__(self, params: EngineParams, stated: Stated, inputs: frozenset[str]) -> None:
        self._p = params
        self._stated = stated
        self._inputs = inputs
        self._frame = LevelFrame(
            params.align_window_s, params.gyro_bias_sigma, params.accel_bias_sigma
        )
        self._headings = Headings(
            self._frame,
            params.align_window_s,
            params.gyro_bias_sigma,
            params.gyro_noise_density,
            params.align_heading,
        )
        self._fixes = Fixes(self._frame.displacement, params.min_fix_sigma)
        self._restarts = 0
        self._ping: tuple[int, Array, float] | None = None
        self._depth: tuple[int, float, float] | None = None
        self._attitude_known = False
        self._why: dict[str, str] = {}
        self._way = ''
        roll, pitch, yaw = np.radians(params.dvl_rpy_deg)
        self._C_m_b = matrix_from_euler(yaw, pitch, roll)
        self._lever_b = np.asarray(params.transponder_lever_b)
        self.progress = Progress(Phase.WAITING, ('IMU samples',))

    def take(self, event: Event) -> Aligned | None:
        """Take the next event; the initial state once it is known, with the sample it holds at."""
        if isinstance(event, ImuSample):
            return self._imu(event)
        if isinstance(event, DvlPing):
            self._velocity(event)
        elif isinstance(event, DepthSample):
            if is_variance(event.variance) and math.isfinite(event.depth):
                self._depth = (event.stamp_ns, event.depth, math.sqrt(event.variance))
        elif isinstance(event, Fix):
            if self._depth is None or self._depth[1] <= event.surface_depth:
                self._fixes.take(event)
        elif isinstance(event, HeadingSample) and self._p.uses_heading:
            self._headings.take(event)
        return None

    def restate(self, stated: Stated) -> None:
        """Take these parts as stated from now on: the vehicle moves while it is aligned."""
        self._stated = stated

    def _imu(self, sample: ImuSample) -> Aligned | None:
        frame, before_ns = self._frame, self._frame.stamp_ns
        p = self._p
        usable = within(sample.omega_ib_b, p.max_rate) and within(sample.f_b, p.max_specific_force)
        if not usable or not math.isfinite(float(sample.omega_ib_b @ sample.f_b)):
            return None
        frame.imu(sample.stamp_ns, sample.omega_ib_b, sample.f_b)
        if sample.C_b_G is not None and np.isfinite(sample.C_b_G).all():
            self._attitude(sample.stamp_ns, sample.C_b_G)
        if frame.restarts != self._restarts:
            self._restarts = frame.restarts
            self._headings.clear()
            self._fixes.clear()
            self._ping = None
        if before_ns is None or sample.stamp_ns // _SECOND_NS == before_ns // _SECOND_NS:
            return None
        return self._look(sample.stamp_ns)

    def _attitude(self, stamp_ns: int, C_b_G: Array) -> None:
        """An attitude in grid axes is the level frame's, with a turn of zero (station mode)."""
        self._attitude_known = True
        self._frame.attitude(C_b_G)
        sigma = math.radians(self._p.station_heading_bias_sigma_deg)
        self._headings.offer(
            Candidate('measured', 0.0, max(sigma, 1e-6), stamp_ns, 'measured by the AHRS (grid)')
        )

    def _velocity(self, ping: DvlPing) -> None:
        if not ping.valid or ping.water or not is_covariance(ping.covariance_m):
            return
        if not within(ping.v_m, self._p.max_speed):
            return
        lever = np.cross(self._frame.omega_b, np.asarray(self._p.dvl_lever_b))
        v_b = self._C_m_b @ ping.v_m - lever
        sigma = math.sqrt(float(np.diagonal(ping.covariance_m).max()))
        self._ping = (ping.stamp_ns, v_b, sigma)
        self._frame.velocity(ping.stamp_ns, v_b, sigma, self._lever_b)

    def _fresh_velocity(self, now_ns: int) -> tuple[Array, float] | None:
        """Velocity over ground, body axes, with 1-sigma that its slow errors are part of."""
        if self._ping is None or now_ns - self._ping[0] > _FRESH_S * 1e9:
            return None
        _, v_b, sigma = self._ping
        scale = self._p.dvl_scale_sigma * float(np.linalg.norm(v_b))
        return v_b, math.hypot(sigma, self._p.dvl_markov_sigma, scale)

    # -- once a second ----------------------------------------------------------------------------

    def _look(self, now_ns: int) -> Aligned | None:
        if not self._attitude_known:
            self._frame.look()
        place = self._place(now_ns, 0.0)
        if place is not None:
            self._frame.earth_up = OMEGA_IE * math.sin(geodetic(place.r_e)[0])
            self._find_heading(place, now_ns)
        heading = self._headings.best()
        if heading is not None:
            place = self._place(now_ns, heading.turn)
        height = None if place is None else self._height(place, now_ns)
        self.progress = self._progress(place, heading, height)
        if self.progress.phase is not Phase.DONE or place is None or heading is None:
            return None
        assert height is not None
        found = self._aligned(now_ns, place, heading, height)
        problem = initial_problem(found.state)
        if problem:
            self.progress = Progress(Phase.WAITING, (f'a sound state ({problem})',))
            return None
        return found

    def _place(self, now_ns: int, turn: float) -> Place | None:
        """Place as stated, or by the newest fix that another one agrees with.

        Without a heading a turn of 0 is good enough for the axes of the place.
        """
        s = self._stated
        if s.latitude is not None and s.longitude is not None:
            r_e = ecef_from_geodetic(s.latitude, s.longitude, s.height or 0.0)
            return Place(np.asarray(r_e), s.sigma_position, math.inf, False, 'as stated')
        fix = self._fixes.agreed(now_ns)
        if fix is None:
            return None
        velocity = self._fresh_velocity(now_ns)
        speed = None if velocity is None else float(np.linalg.norm(velocity[0]))
        return self._fixes.at(fix, now_ns, turn, speed)

    def _find_heading(self, place: Place, now_ns: int) -> None:
        lat, lon, height = geodetic(place.r_e)
        s = self._stated
        if s.heading is not None:
            psi, sigma = 0.5 * math.pi - s.heading, s.sigma_heading
            if s.heading_reference == 'true':
                psi += float(convergence(lat, lon))
                sigma = math.hypot(sigma, convergence_sigma(lat, place.sigma))
            turn = psi - self._frame.yaw
            self._headings.stated = Candidate('stated', turn, sigma, now_ns, 'as stated')
            return
        if self._p.uses_heading and 'heading' in self._inputs:
            self._measured(north_of(self._p, lat, lon, height, place.sigma, now_ns))
        self._gyrocompass(lat, lon, place, now_ns)
        self._course(now_ns)

    def _measured(self, north: North) -> None:
        found = self._headings.measured(north)
        if north.refusal:
            self._why['measured'] = north.refusal
        elif found is None:
            self._why['measured'] = (
                f'its source {HeadingSample.topic} ({north.name}) is silent, or not of now'
            )
        else:
            self._headings.offer(found)
            too_poor = found.sigma > MOST_HEADING
            self._why['measured'] = f'{found.how}: {_good_to(found.sigma)}' if too_poor else ''

    def _gyrocompass(self, lat: float, lon: float, place: Place, now_ns: int) -> None:
        if not self._headings.allows('gyrocompass') or self._attitude_known:
            return
        still, frame = self._frame.still, self._frame
        if still is None or not math.isfinite(frame.sigma_tilt):
            self._why.setdefault('gyrocompass', 'the vehicle is not at rest for a gyrocompass')
            return
        velocity = self._fresh_velocity(now_ns)
        white = self._p.gyro_noise_density / math.sqrt(still.seconds)
        found = gyrocompass(
            still.omega_b,
            frame.tilt,
            lat,
            bias=self._p.gyro_bias_sigma,
            noise=max(white, still.error),
            tilt_sigma=frame.sigma_tilt,
            v_b=None if velocity is None else velocity[0],
            v_sigma=UNKNOWN_SPEED if velocity is None else velocity[1],
        )
        self._why['gyrocompass'] = found.refusal
        if not found.refusal:
            psi = 0.5 * math.pi - found.heading + float(convergence(lat, lon))
            sigma = math.hypot(found.sigma, convergence_sigma(lat, place.sigma))
            how = f'by gyrocompassing for {still.seconds:.0f} s'
            self._headings.offer(Candidate('gyrocompass', psi - frame.yaw, sigma, now_ns, how))

    def _course(self, now_ns: int) -> None:
        self._way = ''
        if not self._headings.allows('course') or 'fix' not in self._inputs:
            return
        if 'dvl' not in self._inputs:
            self._why['course'] = 'without a DVL the course of two fixes is no heading'
            return
        track = np.array(self._frame.track)
        passed = self._fixes.passed(track[:, :3]) if len(track) else []
        p = self._p
        found = course(
            passed,
            MOST_HEADING,
            math.radians(p.dvl_misalignment_sigma_deg),
            p.dvl_markov_sigma,
            p.gyro_bias_sigma,
        )
        if found is None:
            return
        self._why['course'] = found.refusal
        if found.refusal:
            return
        if found.sigma <= MOST_HEADING and math.isfinite(self._frame.sigma_tilt):
            how = f'by the course over {found.baseline:.0f} m between fixes'
            self._headings.offer(Candidate('course', found.turn, found.sigma, now_ns, how))
        elif found.baseline >= _LEAST_WAY:
            self._way = f'heading by the course, {found.baseline:.0f} of {found.needed:.0f} m'
        elif math.isfinite(found.needed):
            self._why['course'] = f'two fixes {found.needed:.0f} m apart under way would give it'

    def _height(self, place: Place, now_ns: int) -> tuple[float, float, str] | None:
        """Height of base_link above the ellipsoid, 1-sigma [m], and where it is from."""
        s, p = self._stated, self._p
        if s.height is not None:
            return s.height, s.sigma_height, 'as stated'
        if self._depth is not None and now_ns - self._depth[0] <= _DEPTH_FRESH_S * 1e9:
            _, depth, sigma = self._depth
            lever = float((self._frame.C_b_L @ np.asarray(p.depth_lever_b))[2])
            height = p.sea_surface_height - depth - lever
            return height, math.hypot(sigma, p.depth_offset_sigma), 'by depth'
        if 'depth' in self._inputs:
            return None
        if place.has_height:
            lever = float((self._frame.C_b_L @ self._lever_b)[2])
            return geodetic(place.r_e)[2] - lever, place.sigma_up, 'of the fix'
        return p.sea_surface_height, _AT_SURFACE, 'at the surface: nothing measures it'

    def _progress(
        self,
        place: Place | None,
        heading: Candidate | None,
        height: tuple[float, float, str] | None,
    ) -> Progress:
        missing, under_way = [], []
        if place is None:
            missing.append(self._place_missing())
        elif height is None:
            missing.append('depth')
        frame, s = self._frame, self._stated
        stated_tilt = s.roll is not None and s.pitch is not None
        if not (math.isfinite(frame.sigma_tilt) or stated_tilt or self._attitude_known):
            if not GRAVITY[0] <= frame.force <= GRAVITY[1] and frame.levelled_s > _FRESH_S:
                missing.append(f'gravity (the mean specific force is {frame.force:.3g} m/s^2)')
            else:
                of_s = self._p.align_window_s
                under_way.append(f'levelling, {frame.levelled_s:.0f} of {of_s:.0f} s')
        if place is not None and heading is None:
            if self._way:
                under_way.append(self._way)
            elif not under_way:  # a gyrocompass needs the same window
                missing.append(f'a heading ({self._heading_missing()})')
        phase = Phase.WAITING if missing else Phase.ALIGNING if under_way else Phase.DONE
        return Progress(phase, tuple(missing), tuple(under_way))

    def _place_missing(self) -> str:
        if 'position' in self._inputs:
            return 'a position of the topic of section initial'
        if 'fix' not in self._inputs:
            return (
                'a place (no source of fixes; state initial_latitude_deg, initial_longitude_deg)'
            )
        return 'a second fix that agrees with the first' if len(self._fixes) else 'a fix'

    def _heading_missing(self) -> str:
        reasons = [why for why in self._why.values() if why]
        if 'heading' not in self._inputs:
            reasons.insert(0, 'no source gives one')
        elif 'measured' not in self._why:
            reasons.insert(0, 'its source is silent, or not of now')
        advice = 'state initial_grid_heading_deg or heading_deg, or call ~/set_initial_state'
        return '; '.join([*reasons, advice])

    def _aligned(
        self,
        now_ns: int,
        place: Place,
        heading: Candidate,
        height: tuple[float, float, str],
    ) -> Aligned:
        frame, s = self._frame, self._stated
        roll, pitch = frame.tilt
        sigma_tilt = frame.sigma_tilt
        how_level = f'by gravity over {frame.levelled_s:.0f} s'
        if self._attitude_known:
            sigma_tilt, how_level = heading.sigma, 'of the AHRS'
        if s.roll is not None and s.pitch is not None:
            roll, pitch, sigma_tilt, how_level = s.roll, s.pitch, s.sigma_tilt, 'as stated'
        psi = heading.turn + frame.yaw
        C_b_G = matrix_from_euler(psi, pitch, roll)
        r_e = place.r_e
        if s.latitude is None:
            lever_G = C_b_G @ self._lever_b
            r_e = r_e - ecef_to_grid(r_e).T @ np.array([lever_G[0], lever_G[1], 0.0])
        lat, lon, _ = geodetic(r_e)
        v_G, sigma_v, how_v = self._start_velocity(now_ns, C_b_G, heading.sigma)
        again = self._p.uses_heading and heading.method == 'measured'
        state = InitialState(
            latitude=lat if s.latitude is None else s.latitude,
            longitude=lon if s.longitude is None else s.longitude,
            height=height[0],
            v_G=v_G,
            roll=roll,
            pitch=pitch,
            grid_heading=math.remainder(0.5 * math.pi - psi, math.tau),
            sigma_position_horizontal=place.sigma,
            sigma_position_vertical=height[1],
            sigma_velocity=sigma_v,
            sigma_tilt=sigma_tilt,
            sigma_heading=heading.sigma * (SAME_AGAIN if again else 1.0),
        )
        how = {
            'place': place.how,
            'height': height[2],
            'level': how_level,
            'heading': f'{heading.how} (1-sigma {math.degrees(heading.sigma):.2g} deg)',
            'velocity': how_v,
        }
        return Aligned(state, now_ns, how)

    def _start_velocity(
        self, now_ns: int, C_b_G: Array, sigma_heading: float
    ) -> tuple[tuple[float, float, float], float, str]:
        s, p = self._stated, self._p
        if s.v_G is not None:
            return s.v_G, s.sigma_velocity, 'as stated'
        found = self._fresh_velocity(now_ns)
        if found is not None:
            v_G = C_b_G @ found[0]
            turned = math.hypot(sigma_heading, math.radians(p.dvl_misalignment_sigma_deg))
            sigma = math.hypot(found[1], turned * float(np.linalg.norm(v_G)))
            return (float(v_G[0]), float(v_G[1]), float(v_G[2])), sigma, 'by the DVL'
        if self._frame.resting:
            return (0.0, 0.0, 0.0), UNKNOWN_SPEED, 'zero: the IMU is at rest'
        return (0.0, 0.0, 0.0), UNKNOWN_VELOCITY, 'zero: nothing measures it'


def _good_to(sigma: float) -> str:
    limit = math.degrees(MOST_HEADING)
    return f'good to {math.degrees(sigma):.2g} deg, the limit is {limit:g} deg'
