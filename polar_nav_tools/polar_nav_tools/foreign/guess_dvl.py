"""The sigma of a ping in a guessed mapping: what an honest heading needs, with a MEMS IMU."""

from __future__ import annotations

import numpy as np

from polar_nav_ros.adapters.layouts import VELOCITY
from polar_nav_ros.adapters.noise_classes import dvl_noise

from ..bags.reader import Topic
from .guess_noise import Choices
from .lines import Lines
from .sources import Source, field_paths, read_table

_MEMS = ('vn100', 'bmi088', 'icm20948')
"""Classes whose gyros hold a heading for minutes: pings would seem to show it."""
_HONEST = 0.03
"""Sigma of a ping with which such a vehicle is not too sure of its heading [m/s]."""


def put_ping_sigma(out: Lines, source: Source, topic: Topic, choices: Choices) -> None:
    """Write the sigma of a ping: stated with a MEMS IMU if pings claim less, else as a comment."""
    if choices.imu in _MEMS and _claimed(source, topic, choices) < _HONEST:
        out.say(f'[m/s], for pings that claim less: with the class {choices.imu} the heading', 2)
        out.say('would be too sure by their noise (docs/limitations.md)', 2)
        out.put(f'sigma: {_HONEST}', 2)
        return
    out.say('sigma: 0.01   # [m/s], in place of what the messages state', 2)


def _claimed(source: Source, topic: Topic, choices: Choices) -> float:
    """Median sigma of the pings [m/s], of the class where they state none."""
    layout = VELOCITY[topic.type]
    there = field_paths(source, topic.name)
    for name, power in (('sigma', 1.0), ('covariance', 0.5)):
        path = layout.get(name, ('',))[0]
        if path in there:
            stated = read_table(source, topic.name, [path]).columns[path].astype(np.float64)
            first = stated.reshape(len(stated), -1)[:, 0]
            good = first[np.isfinite(first) & (first > 0.0)]
            if len(good):
                return float(np.median(good) ** power)
    return float(dvl_noise(choices.dvl)['dvl_sigma']) if choices.dvl is not None else 0.0
