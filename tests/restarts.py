"""Restarts of a follower: how soon it publishes again, how far off it is, how honest.

    python tests/restarts.py BAG [BAG ...]            # those of bags of `./polar launch`
    python tests/restarts.py demo:9971 racetrack:9971   # simulated ones: mission and seed

A simulated follower lives for LIFE_S, and is away for AWAY_S; its state was saved up to a second
before it was killed.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from polar_nav_core.attitude import log
from polar_nav_core.engine.engine import Engine
from polar_nav_core.engine.events import Command, CommandKind, ImuSample
from polar_nav_core.engine.outputs import Estimate
from polar_nav_core.error_model import X
from polar_nav_msgs.msg import Restore
from polar_nav_ros.stamps import NS, stamp_ns_of_cdr, to_ns
from polar_nav_tools.bags import open_bag
from polar_nav_tools.bags.arrays import load_estimates, load_truth
from polar_nav_tools.bags.reader import Bag
from polar_nav_tools.experiments.schedule import FixSpec
from polar_nav_tools.experiments.world import make_world
from polar_nav_tools.experiments.world_spec import WorldSpec
from polar_nav_tools.scoring.align import align
from polar_nav_tools.scoring.consistency import chi_square_band, normalized_squared
from polar_nav_tools.scoring.errors import distance_travelled, errors

FOLLOWER = 'follower'
LIFE_S = (60.0, 120.0)
"""Least and longest time that a simulated follower navigates."""
AWAY_S = (2.0, 8.0)
"""Least and longest time until it takes messages again; a start needs 4 s of one processor."""
SOON_S = 5.0
"""Longest time from the first message that a restarted follower takes to its first estimate."""
PLUS_M, SHARE = 1.0, 0.02
"""Largest error of that estimate: so much, and a share of the way that nobody watched."""
PROBABILITY = 0.999
"""Inside the band of the mean NEES."""
STATES = {'position': 3, 'velocity': 3, 'heading': 1}
"""Degrees of freedom of what is judged."""


@dataclass(frozen=True)
class Restart:
    """First estimate after a restart.

    Attributes
    ----------
    away_s, way_m : float
        From the last estimate before it to the first IMU sample that the follower took: time [s],
        and the true way in it [m].
    stamps_s, published_s : float
        From the first IMU sample that the follower took: by stamps, and as the recorder got both
        messages [s].
    before_m, error_m : float
        Error of the position of the last estimate before, and of the first one after it [m].
    nees : mapping of str to float
        Normalized squared errors of `STATES`.
    """

    away_s: float
    way_m: float
    stamps_s: float
    published_s: float
    before_m: float
    error_m: float
    nees: dict[str, float]

    @property
    def limit_m(self) -> float:
        """Largest error that is asked for [m]."""
        return PLUS_M + SHARE * self.way_m


class Track(NamedTuple):
    """True positions (m, 3), ECEF [m], at stamps (m,) [ns]."""

    stamp_ns: NDArray[np.int64]
    r_e: NDArray[np.float64]


@dataclass(frozen=True)
class _Found:
    """Errors of estimates in order of stamps (n,) [ns], with their covariances, and the truth."""

    stamp_ns: NDArray[np.int64]
    r_e: NDArray[np.float64]
    dr_G: NDArray[np.float64]
    dv_G: NDArray[np.float64]
    phi_G: NDArray[np.float64]
    P_position_G: NDArray[np.float64]
    P_velocity_G: NDArray[np.float64]
    P_attitude_G: NDArray[np.float64]

    def at(self, first: int, track: Track, again_ns: int) -> tuple[float, dict[str, float]]:
        """True way from the row before to a stamp [m], and normalized squared errors at a row."""
        on_the_way = (track.stamp_ns > self.stamp_ns[first - 1]) & (track.stamp_ns <= again_ns)
        way = np.vstack([self.r_e[first - 1], track.r_e[on_the_way]])
        one, heading = slice(first, first + 1), slice(2, 3)
        squared = {
            'position': normalized_squared(self.dr_G[one], self.P_position_G[one]),
            'velocity': normalized_squared(self.dv_G[one], self.P_velocity_G[one]),
            'heading': normalized_squared(
                self.phi_G[one, heading], self.P_attitude_G[one, heading, heading]
            ),
        }
        return distance_travelled(way), {name: float(v[0]) for name, v in squared.items()}


def restarts_of(bag: Bag) -> list[Restart]:
    """Restarts of the follower in a bag with its truth, in their order."""
    truth = load_truth(bag, FOLLOWER).in_order()
    pairs = align(truth, load_estimates(bag, FOLLOWER), mode='interpolate')
    e = errors(pairs)
    found = _Found(
        e.stamp_ns, pairs.truth.r_e, e.dr_G, e.dv_G, e.phi_G,
        e.P_position_G, e.P_velocity_G, e.P_attitude_G,
    )  # fmt: skip
    taken = _recorded_ns(bag, 'imu/data_raw')
    published = _recorded_ns(bag, 'nav/state')
    # A recorder that was started again hears them once more.
    told = dict.fromkeys(data for _, _, data in bag.messages([f'/{FOLLOWER}/nav/restore']))
    begins = [to_ns(deserialize_message(data, Restore).header.stamp) for data in told]
    stamps = [int(found.stamp_ns[np.searchsorted(found.stamp_ns, b)]) for b in begins]
    waits = [(published[ns] - taken[begin]) / NS for begin, ns in zip(begins, stamps, strict=True)]
    return _restarts(found, Track(truth.stamp_ns, truth.r_e), begins, waits)


def _restarts(found: _Found, track: Track, begins: list[int], waits: list[float]) -> list[Restart]:
    """Restarts with first IMU samples at stamps [ns], and when their estimates came [s]."""
    out = []
    for begin_ns, wait_s in zip(begins, waits, strict=True):
        first = int(np.searchsorted(found.stamp_ns, begin_ns))
        way_m, nees = found.at(first, track, begin_ns)
        out.append(
            Restart(
                away_s=(begin_ns - int(found.stamp_ns[first - 1])) / NS,
                way_m=way_m,
                stamps_s=(int(found.stamp_ns[first]) - begin_ns) / NS,
                published_s=wait_s,
                before_m=float(np.linalg.norm(found.dr_G[first - 1])),
                error_m=float(np.linalg.norm(found.dr_G[first])),
                nees=nees,
            )
        )
    return out


def simulated(mission: str, seed: int, count: int = 50) -> list[Restart]:
    """Restarts of a follower in the simulated world of a mission, driven without a node."""
    draw = random.Random(seed)
    lives = [draw.uniform(*LIFE_S) for _ in range(count + 1)]
    aways = [draw.uniform(*AWAY_S) for _ in range(count)]
    spec = WorldSpec(mission=mission, duration_s=math.ceil(sum(lives) + sum(aways)) + 1.0)
    fixes = FixSpec(period_s=2.0, delay_kind='uniform', delay_least_s=0.3, delay_s=3.0)
    world = make_world(spec, fixes, seed)
    params = world.params(configuration='default', output_period_s=0.1)
    events = list(world.inputs.events())
    begin_ns = events[0].stamp_ns
    end_s, saved, begins, estimates = 0.0, None, [], []
    for number, (life_s, away_s) in enumerate(zip(lives, [*aways, 0.0], strict=True)):
        start_s, end_s = end_s, end_s + life_s
        save_s = end_s - draw.random()
        mine = [e for e in events if start_s <= (e.stamp_ns - begin_ns) / NS < end_s]
        if saved is not None:
            begins.append(next(e.stamp_ns for e in mine if isinstance(e, ImuSample)))
            restore = Command(begins[-1], -1, CommandKind.RESTORE, saved, 'nav/restore')
            mine = sorted([*mine, restore], key=lambda e: e.key)
        engine, saved = Engine(params), None
        for event in mine:
            if saved is None and (event.stamp_ns - begin_ns) / NS >= save_s:
                saved = engine.saved()
            estimates += [o for o in engine.process(event) if isinstance(o, Estimate)]
        if number < count and saved is None:
            saved = engine.saved()
        end_s += away_s
    stamps = np.array([e.stamp_ns for e in estimates])
    truth, P = world.truth.state(stamps), np.array([e.P for e in estimates])
    C_e_G = truth.C_e_G
    turned = np.array([e.C_b_G for e in estimates]) @ np.swapaxes(truth.C_b_G, 1, 2)
    found = _Found(
        stamp_ns=stamps,
        r_e=truth.r_e,
        dr_G=np.einsum('nij,nj->ni', C_e_G, np.array([e.r_e for e in estimates]) - truth.r_e),
        dv_G=np.array([e.v_G for e in estimates]) - truth.v_G,
        phi_G=-log(turned),
        P_position_G=C_e_G @ P[:, X.dr_e, X.dr_e] @ np.swapaxes(C_e_G, 1, 2),
        P_velocity_G=P[:, X.dv_G, X.dv_G],
        P_attitude_G=P[:, X.phi_G, X.phi_G],
    )
    # Nothing waits between the sample and its estimate.
    imu_ns = world.inputs.imu_stamps_ns
    track = Track(imu_ns, world.truth.state(imu_ns).r_e)
    return _restarts(found, track, begins, [0.0] * count)


def _recorded_ns(bag: Bag, topic: str) -> dict[int, int]:
    """Times at which messages of a topic were recorded, by their stamps [ns]."""
    messages = bag.messages([f'/{FOLLOWER}/{topic}'])
    return {stamp_ns_of_cdr(data): time_ns for _, time_ns, data in messages}


def band(count: int, dof: int) -> tuple[float, float]:
    """Band of the mean NEES of independent restarts."""
    low, high = chi_square_band(dof * count, PROBABILITY)
    return float(low) / count, float(high) / count


def late_or_off(found: Sequence[Restart]) -> list[str]:
    """One sentence for each restart whose first estimate came late, or was too far off."""
    said = []
    for number, r in enumerate(found, start=1):
        if max(r.stamps_s, r.published_s) > SOON_S:
            said.append(f'restart {number}: first estimate after {r.published_s:.2f} s')
        if not r.error_m <= r.limit_m:
            said.append(f'restart {number}: {r.error_m:.2f} m off, {r.limit_m:.2f} m are allowed')
    return said


def optimistic(found: Sequence[Restart]) -> list[str]:
    """One sentence for each of `STATES` whose mean NEES is above its band.

    Below it is no fault: the covariance has room for a turn that began and ended unseen, and on
    most ways there is none.
    """
    said = []
    for name, dof in STATES.items():
        _, high = band(len(found), dof)
        mean = float(np.mean([r.nees[name] for r in found]))
        if not mean <= high:
            said.append(f'{name}: mean NEES {mean:.2f}, the band ends at {high:.2f}')
    return said


def table_of(found: Sequence[Restart]) -> str:
    """Lines for a person: ranges over the restarts, and mean NEES with their bands."""
    rows: dict[str, list[float]] = {
        'away [s]': [r.away_s for r in found],
        'way meanwhile [m]': [r.way_m for r in found],
        'first estimate after, by stamps [s]': [r.stamps_s for r in found],
        'first estimate after, as recorded [s]': [r.published_s for r in found],
        'error before [m]': [r.before_m for r in found],
        'error of the first estimate [m]': [r.error_m for r in found],
        'that error / (1 m + 2 % of the way)': [r.error_m / r.limit_m for r in found],
    }
    lines = [f'{len(found)} restarts']
    for name, values in rows.items():
        v: NDArray[np.float64] = np.array(values)
        lines.append(f'  {name}: median {np.median(v):.2f}, {v.min():.2f} to {v.max():.2f}')
    for name, dof in STATES.items():
        low, high = band(len(found), dof)
        mean = float(np.mean([r.nees[name] for r in found]))
        lines.append(f'  NEES of {name}: mean {mean:.2f}, 99.9 % band {low:.2f} to {high:.2f}')
    missed = late_or_off(found) + optimistic(found)
    return '\n'.join([*lines, *(f'  missed: {problem}' for problem in missed)])


def main(names: Sequence[str]) -> int:
    """Print tables of bags and simulated missions; status 1 if a bound is missed in one."""
    found = []
    for name in names:
        mission, _, seed = name.partition(':')
        one = simulated(mission, int(seed)) if seed else restarts_of(open_bag(Path(name)))
        sys.stdout.write(f'{name}: {table_of(one)}\n')
        found.append(one)
    if len(found) > 1:
        sys.stdout.write(f'all: {table_of([r for one in found for r in one])}\n')
    return 1 if any(late_or_off(one) or optimistic(one) for one in found) else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
