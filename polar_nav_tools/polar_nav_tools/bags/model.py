"""Vehicle model and water of a bag or of a replay, as the arrays of `series.model`.

Reads `nav/model` and `nav/identification` (messages or their bytes) and, for the truth,
`truth/model`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from polar_nav_ros.topics import IDENTIFICATION, MODEL, TRUE_MODEL

from ..series.model import Identified, ModelRun, ModelSeries
from . import Bag
from .columns import Columns, read_columns, stamps, time_fields
from .errors import BagError
from .schemas import Definition, definition

AHRS_NODE = 'imu_node'
MODEL_TYPE = 'polar_nav_msgs/msg/VehicleModel'

_SAME = (
    'v_r_b',
    'drag_linear',
    'drag_linear_sigma',
    'drag_quadratic',
    'drag_quadratic_sigma',
    'drag_correlation',
    'heading_bias',
    'heading_bias_sigma',
    'current_walk',
)
_FIELDS = (
    *time_fields('header.stamp'),
    *_SAME,
    'v_r_covariance_b',
    'current_g',
    'current_covariance_g',
)


def load_model_run(bag: Bag, vehicle: str) -> ModelRun | None:
    """Model recorded from the live run; None if no model took part.

    Raises
    ------
    BagError
        For a message that cannot be decoded.
    """
    estimated = _load(bag, f'/{vehicle}/{MODEL}')
    if estimated is None:
        return None
    return ModelRun(
        estimated, _identified(bag, f'/{vehicle}/{IDENTIFICATION}'), load_true_model(bag, vehicle)
    )


def load_true_model(bag: Bag, vehicle: str) -> ModelSeries | None:
    """True model; None if it is not recorded.

    The heading bias is that of the AHRS, read from the parameters of its node.
    """
    truth = _load(bag, f'/{vehicle}/{TRUE_MODEL}')
    ahrs = bag.node_infos.get(f'/{vehicle}/{AHRS_NODE}', {}).get('params', {})
    if truth is None or 'ahrs_heading_bias_deg' not in ahrs:
        return truth
    bias = math.radians(float(ahrs['ahrs_heading_bias_deg']))
    return replace(truth, heading_bias=np.full(len(truth), bias))


def model_run_from_cdr(
    model: Iterable[bytes], identified: Iterable[bytes], truth: ModelSeries | None
) -> ModelRun | None:
    """Model of a replay; None if no model took part."""
    series = model_from_cdr(model)
    if not len(series):
        return None
    from rclpy.serialization import deserialize_message

    from polar_nav_msgs.msg import Identification as IdentificationMsg

    found = (deserialize_message(data, IdentificationMsg) for data in identified)
    return ModelRun(series, tuple(_identified_of(m) for m in found), truth)


def model_from_cdr(messages: Iterable[bytes]) -> ModelSeries:
    """Model series of serialized nav/model messages, by the installed definition."""
    return _series(list(messages), definition(MODEL_TYPE))


def _load(bag: Bag, topic: str) -> ModelSeries | None:
    if topic not in bag.topics or not bag.topics[topic].count:
        return None
    kind = bag.channel(topic).type
    if kind != MODEL_TYPE:
        raise BagError(f'{bag.path}: {topic} is a {kind}, not a {MODEL_TYPE}')
    return _series(bag.payloads(topic), bag.definition(topic))


def _series(messages: Iterable[bytes], described: Definition) -> ModelSeries:
    c: Columns = read_columns(messages, described.type, described.text, _FIELDS)
    return ModelSeries(
        stamp_ns=stamps(c, 'header.stamp'),
        P_v_r_b=c['v_r_covariance_b'].reshape(-1, 3, 3),
        current_G=c['current_g'],
        P_current_G=c['current_covariance_g'].reshape(-1, 3, 3),
        **{name: c[name] for name in _SAME},
    )


def _identified(bag: Bag, topic: str) -> tuple[Identified, ...]:
    if topic not in bag.topics or not bag.topics[topic].count:
        return ()
    return tuple(_identified_of(message) for _, message in bag.read(topic))


def _identified_of(m: Any) -> Identified:  # noqa: ANN401 - polar_nav_msgs/Identification
    names = [str(name) for name in m.names]
    values = np.asarray(m.values, dtype=np.float64)
    covariance = np.asarray(m.covariance, dtype=np.float64)
    count = len(names)
    variances = np.full(count, np.nan)
    if covariance.size == count * count:
        variances = np.diagonal(covariance.reshape(count, count))
    sigmas = np.sqrt(np.where(variances >= 0.0, variances, np.nan))
    stamp = m.header.stamp
    return Identified(
        stamp_ns=int(stamp.sec) * 10**9 + int(stamp.nanosec),
        method=str(m.method),
        verdict=str(m.verdict_text),
        reason=str(m.reason),
        trigger=str(m.trigger),
        fixes=int(m.fixes),
        values=dict(zip(names, values.tolist(), strict=False)),
        sigmas=dict(zip(names, sigmas.tolist(), strict=False)),
        condition_number=float(m.condition_number),
        cost=float(m.cost),
        iterations=int(m.iterations),
    )
