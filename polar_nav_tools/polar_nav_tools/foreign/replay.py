"""Runs the engine on a foreign bag; estimates as series, as messages and as a bag of this project.

The bag that is written holds `nav/state`, `nav/receipt` and, where a reference was mapped,
`truth`: `./polar score --recorded` and `./polar report --recorded` take it as any other.
"""

from __future__ import annotations

import hashlib
import heapq
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polar_nav_core.engine import run as engine_run
from polar_nav_core.engine.health.conditions import Health
from polar_nav_core.engine.health.runaway import divergence_of
from polar_nav_core.engine.health.span import span_of_health
from polar_nav_core.engine.outputs import Estimate, Receipt
from polar_nav_core.errors import ConfigError
from polar_nav_core.params import to_mapping
from polar_nav_follower.params import FollowerParams
from polar_nav_msgs.msg import VehicleTruth
from polar_nav_ros import topics
from polar_nav_ros.adapters.mapping import Mapping
from polar_nav_ros.cdr import to_bytes
from polar_nav_ros.navigation_outputs import nav_to_msg, receipt_to_msg
from polar_nav_ros.stamps import to_msg

from ..bags import BagWriter
from ..bags.finding import Finding
from ..replay.result import LOOK_EVERY_S
from ..scoring import Comparison, compare
from ..scoring.consistency import OPTIMISTIC, PESSIMISTIC
from ..series.estimates import EstimateRows, receipts_of
from ..series.vehicle import EstimateSeries, TruthSeries
from .findings import to_dict as finding_values
from .hindsight import BEYOND, is_misfit, look_back
from .lever import at_the_imu
from .load import Loaded, load
from .sources import Source

_NOT_KEPT = np.zeros((0, 0))
"""Covariance of an estimate of which only the derived columns are known."""
Row = tuple[int, str, bytes]
"""Stamp [ns], topic without the vehicle, CDR bytes."""


@dataclass(frozen=True, eq=False)
class ForeignRun:
    """What the engine made of a foreign bag.

    Attributes
    ----------
    loaded : Loaded
        Inputs, parameters and findings.
    estimates : EstimateSeries
    states : tuple of Row
        The estimates as messages of this project, where they were asked for.
    receipts : tuple of Receipt
    verdicts : dict of str to int
    divergence : str
    findings : tuple of Finding
        Those of the data, and what did not fit in the run.
    health : tuple of Health
        Judgements of the watchdog in the order of time.
    """

    loaded: Loaded
    estimates: EstimateSeries
    states: tuple[Row, ...]
    receipts: tuple[Receipt, ...]
    verdicts: dict[str, int]
    divergence: str
    findings: tuple[Finding, ...] = ()
    health: tuple[Health, ...] = ()

    @property
    def vehicle(self) -> str:
        """Name that the mapping gives."""
        return self.loaded.mapping.vehicle

    def complaints(self) -> list[str]:
        """Sentences on what was not well in the run; empty if all was."""
        why = self.divergence
        out = [f'the filter diverged: {why}'] if why else []
        misfits = [f'{f.name}: {f.topic} {BEYOND}' for f in self.findings if is_misfit(f)]
        complaint = span_of_health(self.health).complaint
        return [*out, *misfits, *([complaint] if complaint else [])]

    @property
    def remark(self) -> str:
        """Sentence on a WARN at the end, or for long; empty without one."""
        return span_of_health(self.health).remark

    def comparison(self) -> Comparison | None:
        """Score against the reference; None where none was mapped or nothing was estimated."""
        truth = self.loaded.truth
        if truth is None or not len(self.estimates):
            return None
        name = self.loaded.params.configuration
        return compare({name: (truth, self.estimates, receipts_of(self.receipts))})


def replay(
    source: Source,
    mapping: Mapping,
    *,
    accept: Iterable[str] = (),
    messages: bool = False,
    progress: engine_run.Progress | None = None,
) -> ForeignRun:
    """Load a bag by its mapping and run the engine over it.

    Parameters
    ----------
    source, mapping : Source, Mapping
    accept : iterable of str
        Severe findings to take as they are.
    messages : bool
        Make messages of the estimates, too, for `write`; some thousand per second.
    progress : callable, optional

    Raises
    ------
    Refused
        When the data have severe findings that nobody accepted.
    ConfigError
        When no IMU sample is left after the start.
    """
    return run(load(source, mapping, accept), messages=messages, progress=progress)


def run(
    loaded: Loaded, *, messages: bool = False, progress: engine_run.Progress | None = None
) -> ForeignRun:
    """Run the engine over what was loaded; parameters and errors as `replay`."""
    if not len(loaded.inputs.imu_stamps_ns):
        raise ConfigError(
            f'{loaded.source.path}: no IMU sample after the start at '
            f'{loaded.start.stamp_ns / 1e9:.3f} s'
        )
    rows = EstimateRows(loaded.params, _expected(loaded))
    states: list[Row] = []

    def take(chunk: engine_run.Track) -> None:
        rows.append(chunk)
        if messages:
            states.extend(states_of(chunk, loaded.params, loaded.mapping.vehicle))

    result = engine_run.run(
        loaded.params,
        loaded.inputs,
        progress=progress,
        sink=take,
        derived=not messages,  # for messages covariances are wanted as they are
        look_every_s=LOOK_EVERY_S,
        imu_lever_b=loaded.mapping.imu.lever_b,
    )
    verdicts = Counter(r.verdict.name for r in result.receipts)
    estimates = rows.series(loaded.mapping.vehicle)
    statistics = estimates.local_statistics.sum(axis=0)
    return ForeignRun(
        loaded,
        estimates,
        tuple(states),
        tuple(result.receipts),
        dict(sorted(verdicts.items())),
        result.divergence or divergence_of(result.health),
        (*loaded.findings, *look_back(loaded, at_the_imu(loaded), statistics, result.receipts)),
        result.health,
    )


def _expected(loaded: Loaded) -> int:
    """Return the number of estimates, about: one each period, none between two samples."""
    stamps_ns = loaded.inputs.imu_stamps_ns
    periods = float(stamps_ns[-1] - stamps_ns[0]) * 1e-9 / loaded.params.output_period_s
    return min(int(periods) + 2, len(stamps_ns))


def states_of(track: engine_run.Track, params: FollowerParams, vehicle: str) -> Iterator[Row]:
    """Return the rows of a track as messages of nav/state: with covariances or derived columns."""
    known = len(track.derived) == len(track.stamps_ns)
    for k in range(len(track.stamps_ns)):
        errors = track.sensor_errors[k]
        estimate = Estimate(
            stamp_ns=int(track.stamps_ns[k]),
            r_e=track.r_e[k],
            v_G=track.v_G[k],
            C_b_G=track.C_b_G[k],
            P=_NOT_KEPT if known else track.P[k],
            gyro_bias_b=errors[0:3],
            accel_bias_b=errors[3:6],
            dvl_scale_m=errors[6:9],
            dvl_markov_m=errors[9:12],
            usbl_bias_a=errors[12:15],
            fixes_received=int(track.fixes[k, 0]),
            fixes_fused=int(track.fixes[k, 1]),
            last_validity_ns=int(track.fixes[k, 2]),
            local_statistics=track.local_statistics[k],
        )
        row = track.derived[k] if known else None
        message = nav_to_msg(estimate, params, vehicle, row=row)
        yield estimate.stamp_ns, topics.STATE, to_bytes(message)


def truth_messages(truth: TruthSeries) -> Iterator[Row]:
    """Return a reference as messages of this project; NaN where it says nothing."""
    for k in range(len(truth)):
        message = VehicleTruth()
        message.header.stamp = to_msg(int(truth.stamp_ns[k]))
        message.header.frame_id = 'earth'
        message.sequence = int(truth.sequence[k])
        message.r_e = truth.r_e[k]
        message.latitude = float(truth.latitude[k])
        message.longitude = float(truth.longitude[k])
        message.height = float(truth.height[k])
        message.depth = message.altitude = float('nan')
        message.v_g = truth.v_G[k]
        message.c_b_g = truth.C_b_G[k].reshape(9)
        message.omega_ib_b = message.f_b = message.current_g = np.full(3, np.nan)
        yield int(truth.stamp_ns[k]), topics.TRUTH, to_bytes(message)


def write(path: Path, run_: ForeignRun) -> Path:
    """Write the outputs to a new bag, each under its own stamp.

    Raises
    ------
    BagError
        When the bag exists or cannot be written.
    """
    loaded = run_.loaded
    if len(run_.states) != len(run_.estimates):
        raise ValueError('this run kept no messages: run it with messages=True')
    receipts = [(r.stamp_ns, topics.RECEIPT, to_bytes(receipt_to_msg(r))) for r in run_.receipts]
    streams: list[Iterable[Row]] = [run_.states, receipts]
    if loaded.truth is not None:
        streams.append(truth_messages(loaded.truth))
    info: dict[str, object] = {
        'replay_of': str(loaded.source.path),
        'mapping': loaded.mapping.place,
        'configuration': loaded.params.configuration,
        'parameters': to_mapping(loaded.params),
        'findings': [finding_values(f) for f in run_.findings],
        'verdicts': run_.verdicts,
    }
    with BagWriter(path, info) as writer:
        for topic in (topics.STATE, topics.RECEIPT, *([topics.TRUTH] if len(streams) > 2 else [])):
            writer.add_topic(f'/{run_.vehicle}/{topic}', topics.TYPES[topic])
        for stamp_ns, topic, data in heapq.merge(*streams, key=lambda row: row[0]):
            writer.write(f'/{run_.vehicle}/{topic}', data, stamp_ns)
    return path


def nees_judged(comparison: Comparison) -> str:
    """Return NEES/3 of the second half, judged in a word, and the limit that it is beyond."""
    (score,) = comparison.scores.values()
    nees = score.second_half.nees_position
    limit = {OPTIMISTIC: nees.band_high, PESSIMISTIC: nees.band_low}.get(nees.judgement)
    beyond = '' if limit is None else f', limit {limit:.3g}'
    return f'{nees.mean_per_dof:.3g}, {nees.judgement}{beyond}'


def summary(run_: ForeignRun) -> dict[str, Any]:
    """Say what a run did, in plain values."""
    loaded = run_.loaded
    inputs = loaded.inputs
    estimates = run_.estimates
    digest = hashlib.sha256()
    for values in (estimates.stamp_ns, estimates.r_e, estimates.v_G, estimates.C_b_G):
        digest.update(np.ascontiguousarray(values).tobytes())
    return {
        'bag': str(loaded.source.path),
        'kind': loaded.source.kind,
        'vehicle': run_.vehicle,
        'configuration': loaded.params.configuration,
        'start': loaded.start.how,
        'imu': len(inputs.imu_stamps_ns),
        'dvl': len(inputs.dvl_stamps_ns),
        'depth': len(inputs.depth_stamps_ns),
        'fixes': len(inputs.fixes),
        'estimates': len(estimates),
        'verdicts': run_.verdicts,
        'sha256': digest.hexdigest(),
        'divergence': run_.divergence or None,
        'health': span_of_health(run_.health).to_dict(),
    }
