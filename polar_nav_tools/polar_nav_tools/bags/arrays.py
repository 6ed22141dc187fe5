"""Truth, estimates and receipts of a vehicle as arrays (`polar_nav_tools.series.vehicle`).

`load_*` read them from a bag, with the definitions in the bag; `*_from_cdr` decode serialized
messages of any origin, a replay for example, with the installed definitions.
Both decode with `columns.read_columns`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polar_nav_core import spilled
from polar_nav_core.engine.outputs import LOCAL_DOF
from polar_nav_core.engine.version import DOF_STATED, engine_version_of
from polar_nav_core.nav_columns import rotations
from polar_nav_ros import receipt_fields
from polar_nav_tools.series.vehicle import EstimateSeries, Floats, ReceiptRecord, TruthSeries

from .columns import Columns, read_columns, stamps, time_fields
from .errors import BagError
from .reader import Bag
from .schemas import Definition, definition

TRUTH_TYPE = 'polar_nav_msgs/msg/VehicleTruth'
ESTIMATE_TYPE = 'polar_nav_msgs/msg/NavState'
RECEIPT_TYPE = 'polar_nav_msgs/msg/FixReceipt'

STAMP = time_fields('header.stamp')
_TRUTH_SAME = ('latitude', 'longitude', 'height', 'depth', 'altitude', 'omega_ib_b', 'f_b')
TRUTH_FIELDS = (*STAMP, *_TRUTH_SAME, 'r_e', 'sequence', 'v_g', 'c_b_g', 'current_g')

_ESTIMATE_SAME = (
    'status',
    'latitude',
    'longitude',
    'height',
    'depth',
    'roll',
    'pitch',
    'grid_heading',
    'true_heading',
    'true_heading_sigma',
    'convergence',
    'gyro_bias_b',
    'gyro_bias_sigma',
    'accel_bias_b',
    'accel_bias_sigma',
    'dvl_scale_m',
    'dvl_scale_sigma',
    'dvl_markov_m',
    'dvl_markov_sigma',
    'usbl_bias_a',
    'usbl_bias_sigma',
    'age_of_last_fix',
)
_QUATERNION = tuple(f'orientation.{c}' for c in 'xyzw')
_ESTIMATE_FIELDS = (
    *STAMP,
    *_ESTIMATE_SAME,
    *_QUATERNION,
    'r_e',
    'configuration',
    'v_g',
    'position_covariance_g',
    'velocity_covariance_g',
    'attitude_covariance_g',
    'fixes_received',
    'fixes_fused',
)

_LOCAL = tuple(
    tuple(f'{source}_{what}' for what in ('updates', 'gated', 'nis_sum')) for source in LOCAL_DOF
)
"""Fields of the local statistics, by source; bags of earlier versions do not have them."""

_RECEIPT_FIELDS = (
    *STAMP,
    *(part for name in receipt_fields.TIMES.values() for part in time_fields(name)),
    *receipt_fields.VALUES.values(),
    *receipt_fields.AXES.values(),
    'verdict',
    'verdict_text',
    'age',
)


def load_truth(bag: Bag, vehicle: str) -> TruthSeries:
    """Load ``/<vehicle>/truth``.

    Raises
    ------
    BagError
        If the bag has no such message, or one that cannot be decoded.
    """
    return truth_of(_load(bag, f'/{vehicle}/truth', TRUTH_TYPE, TRUTH_FIELDS), vehicle)


def load_estimates(bag: Bag, vehicle: str) -> EstimateSeries:
    """Load ``/<vehicle>/nav/state``; errors as `load_truth`."""
    topic = f'/{vehicle}/nav/state'
    described = bag.definition(topic) if topic in bag.topics else definition(ESTIMATE_TYPE)
    columns = _load(bag, topic, ESTIMATE_TYPE, _estimate_fields(described))
    return _estimates(columns, vehicle)


def load_receipts(bag: Bag, vehicle: str) -> list[ReceiptRecord]:
    """Load ``/<vehicle>/nav/receipt``, all revisions; empty if there is none.

    A run without a fix has no receipt and is a bag like any other.
    """
    topic = f'/{vehicle}/nav/receipt'
    if topic not in bag.topics or not bag.topics[topic].count:
        return []
    receipts = _receipts(_load(bag, topic, RECEIPT_TYPE, _RECEIPT_FIELDS))
    if _states_dof(bag, vehicle):
        return receipts
    return [receipt.counted_by_variance() for receipt in receipts]


def _states_dof(bag: Bag, vehicle: str) -> bool:
    """Whether receipts of a vehicle were written by engines that state degrees of freedom."""
    names = {n for n in bag.node_infos if n.startswith(f'/{vehicle}/')}
    versions = [engine_version_of(bag.node_infos[name]) for name in names]
    return bool(versions) and min(versions) >= DOF_STATED


def truth_from_cdr(messages: Iterable[bytes], vehicle: str) -> TruthSeries:
    """Decode serialized VehicleTruth messages."""
    return truth_of(_decode(messages, definition(TRUTH_TYPE), TRUTH_FIELDS), vehicle)


def estimates_from_cdr(messages: Iterable[bytes], vehicle: str) -> EstimateSeries:
    """Decode serialized NavState messages."""
    described = definition(ESTIMATE_TYPE)
    return _estimates(_decode(messages, described, _estimate_fields(described)), vehicle)


def receipts_from_cdr(messages: Iterable[bytes]) -> list[ReceiptRecord]:
    """Decode serialized FixReceipt messages."""
    return _receipts(_decode(messages, definition(RECEIPT_TYPE), _RECEIPT_FIELDS))


def _load(bag: Bag, topic: str, type_name: str, fields: Sequence[str]) -> Columns:
    found = bag.channel(topic).type
    if found != type_name:
        raise BagError(f'{bag.path}: {topic} is a {found}, not a {type_name}')
    try:
        return _decode(bag.payloads(topic), bag.definition(topic), fields)
    except BagError as error:
        if str(bag.path) in str(error):
            raise
        raise BagError(f'{bag.path}: {topic}: {error}') from error


def _estimate_fields(described: Definition) -> tuple[str, ...]:
    words = set(re.findall(r'\w+', described.text))
    return (*_ESTIMATE_FIELDS, *(name for names in _LOCAL for name in names if name in words))


def _decode(messages: Iterable[bytes], described: Definition, fields: Sequence[str]) -> Columns:
    return read_columns(messages, described.type, described.text, fields)


def _matrices(rows: NDArray[Any]) -> Floats:
    return np.asarray(rows.reshape(-1, 3, 3))


def truth_of(c: Columns, vehicle: str) -> TruthSeries:
    """Truth series from the columns `TRUTH_FIELDS`."""
    return TruthSeries(
        vehicle=vehicle,
        stamp_ns=stamps(c, 'header.stamp'),
        sequence=spilled.by_rows(lambda s: s.astype(np.int64), c['sequence']),
        r_e=places(c['r_e']),
        v_G=c['v_g'],
        C_b_G=_matrices(c['c_b_g']),
        current_G=c['current_g'],
        **{name: c[name] for name in _TRUTH_SAME},
    )


def _estimates(c: Columns, vehicle: str) -> EstimateSeries:
    configurations = tuple(dict.fromkeys(c['configuration'].tolist()))
    return EstimateSeries(
        vehicle=vehicle,
        configuration=configurations[0] if configurations else '',
        configurations=configurations,
        stamp_ns=stamps(c, 'header.stamp'),
        r_e=places(c['r_e']),
        v_G=c['v_g'],
        C_b_G=rotations(np.column_stack([c[q] for q in _QUATERNION])),
        P_position_G=_matrices(c['position_covariance_g']),
        P_velocity_G=_matrices(c['velocity_covariance_g']),
        P_attitude_G=_matrices(c['attitude_covariance_g']),
        fixes_received=c['fixes_received'].astype(np.int64),
        fixes_fused=c['fixes_fused'].astype(np.int64),
        local_statistics=_local_statistics(c),
        **{name: c[name] for name in _ESTIMATE_SAME},
    )


def places(r_e: Floats) -> Floats:
    """Return ECEF positions, shape (n, 3) [m], with NaN for those within 1 m of the centre.

    No vehicle is there, and a message that was never filled in is; up is undefined.
    """
    if not len(r_e):
        return r_e

    def at_centre(r_e: Floats) -> NDArray[np.bool_]:
        with np.errstate(over='ignore', under='ignore', invalid='ignore'):
            return np.asarray(np.sum(r_e * r_e, axis=-1) < 1.0)

    nowhere = spilled.by_rows(at_centre, r_e)
    if not nowhere.any():
        return r_e
    return spilled.by_rows(lambda r_e, at: np.where(at[:, None], np.nan, r_e), r_e, nowhere)


def _local_statistics(c: Columns) -> Floats:
    out = np.zeros((len(c['status']), len(_LOCAL), 3))
    for i, names in enumerate(_LOCAL):
        for j, name in enumerate(names):
            if name in c:
                out[:, i, j] = c[name]
    return out


def _receipts(c: Columns) -> list[ReceiptRecord]:
    columns: dict[str, Any] = {
        'stamp_ns': stamps(c, 'header.stamp').tolist(),
        'verdict': c['verdict'].tolist(),
        'verdict_text': c['verdict_text'].tolist(),
        'age_s': c['age'].tolist(),
        **{name: stamps(c, field).tolist() for name, field in receipt_fields.TIMES.items()},
        **{name: c[field].tolist() for name, field in receipt_fields.VALUES.items()},
        **{name: c[field] for name, field in receipt_fields.AXES.items()},
    }
    rows = zip(*columns.values(), strict=True)
    return [ReceiptRecord.of(dict(zip(columns, row, strict=True))) for row in rows]
