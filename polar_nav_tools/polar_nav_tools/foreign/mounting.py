"""Where sensors sit on a vehicle, by the static transforms of a recording (/tf_static).

In: the transforms, and the frame that the messages of a sensor name. Out: its place and axes in
base_link (x forward, y left, z up: REP 103), or nothing where no chain of transforms leads there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from polar_nav_core.arrays import Array
from polar_nav_core.attitude import euler_from_matrix
from polar_nav_core.errors import PolarNavError
from polar_nav_ros.adapters import rotations
from polar_nav_ros.topics import TF_STATIC, TYPES

from ..bags.decode import store_of
from ..bags.reader import Topic
from .lines import Lines
from .sources import Source, field_paths

_BASE = 'base_link'
_SAME = 1e-4
"""Of a rotation: below what the text of a file states."""


class Transform(NamedTuple):
    """A static transform: ``p_parent = C p_child + r``.

    Attributes
    ----------
    parent, child : str
        Frames, without a leading slash.
    r : (3,) array
        Origin of the child, parent's axes [m].
    C : (3, 3) array
        Child's axes to parent's.
    """

    parent: str
    child: str
    r: Array
    C: Array


class Mount(NamedTuple):
    """Place and axes of a sensor on the vehicle.

    Attributes
    ----------
    frame, base : str
        Frame of its messages, and that of the vehicle.
    lever_b : (3,) array
        From base_link [m].
    C_s_b : (3, 3) array
        Sensor's axes to the body's.
    """

    frame: str
    base: str
    lever_b: Array
    C_s_b: Array

    @property
    def lever_text(self) -> str:
        """``[x, y, z]`` for a mapping file."""
        return str([float(v) for v in np.round(self.lever_b, 4) + 0.0])

    @property
    def rotation_text(self) -> str:
        """Name of the axes, or their angles, for a mapping file."""
        for name, C_s_b in rotations.all_named().items():
            if np.abs(C_s_b - self.C_s_b).max() < _SAME:
                return name
        yaw, pitch, roll = (float(v) for v in euler_from_matrix(self.C_s_b))
        rpy_deg = np.round(np.degrees([roll, pitch, yaw]), 3) + 0.0
        return f'{{rpy_deg: {[float(v) for v in rpy_deg]}}}'

    @property
    def source_text(self) -> str:
        """What the numbers rest on."""
        return f'by {TF_STATIC}: {self.frame} in {self.base}'


class Mounts:
    """Places of sensors by static transforms.

    Parameters
    ----------
    transforms : iterable of Transform
    """

    def __init__(self, transforms: Iterable[Transform] = ()) -> None:
        self._beside: dict[str, list[Transform]] = {}
        for t in transforms:
            self._beside.setdefault(t.parent, []).append(t)
            self._beside.setdefault(t.child, []).append(
                Transform(t.child, t.parent, -t.C.T @ t.r, t.C.T)
            )

    def of(self, frame: str) -> Mount | None:
        """Place of a frame in the base_link that it hangs together with; None without one."""
        frame = frame.lstrip('/')
        seen = {frame}
        waiting = deque([(frame, np.zeros(3), np.eye(3))])
        while waiting:
            # What is known: p_here = C p_frame + r.
            here, r, C = waiting.popleft()
            if here.rpartition('/')[2] == _BASE:
                return Mount(frame, here, r, C)
            for t in self._beside.get(here, ()):
                if t.child not in seen:
                    seen.add(t.child)
                    waiting.append((t.child, t.C.T @ (r - t.r), t.C.T @ C))
        return None

    def of_topic(self, source: Source, topic: Topic | None) -> Mount | None:
        """Place of a topic's sensor, by the frame that its first message names."""
        if topic is None or not self._beside:
            return None
        try:
            if 'header.frame_id' not in field_paths(source, topic.name):
                return None
            _, data = next(source.records(topic.name))
            message = store_of(source.text(topic.name), topic.type).deserialize_cdr(
                data, topic.type
            )
        except PolarNavError:
            return None
        return self.of(str(message.header.frame_id))  # type: ignore[attr-defined]


def mounts_of(source: Source) -> Mounts:
    """Static transforms of a recording; of a frame that is stated twice, the last one."""
    found: dict[str, Transform] = {}
    for topic in source.topics.values():
        if not topic.count or topic.type != TYPES[TF_STATIC] or not topic.name.endswith(TF_STATIC):
            continue
        store = store_of(source.text(topic.name), topic.type)
        for _, data in source.records(topic.name):
            message = store.deserialize_cdr(data, topic.type)
            for one in message.transforms:  # type: ignore[attr-defined]
                transform = _transform(one)
                if transform is not None:
                    found[transform.child] = transform
    return Mounts(found.values())


def _transform(message: object) -> Transform | None:
    """Transform of a geometry_msgs/TransformStamped; None where it is none."""
    t = message.transform  # type: ignore[attr-defined]
    r = np.array([t.translation.x, t.translation.y, t.translation.z])
    xyzw = np.array([t.rotation.x, t.rotation.y, t.rotation.z, t.rotation.w])
    if not (np.isfinite(r).all() and np.isfinite(xyzw).all() and xyzw.any()):
        return None
    parent, child = (
        str(name).lstrip('/')
        for name in (message.header.frame_id, message.child_frame_id)  # type: ignore[attr-defined]
    )
    return Transform(parent, child, r, rotations.from_quaternion(xyzw.tolist()))


def put_lever(out: Lines, mount: Mount | None, beside: str = '') -> None:
    """Write the lever arm of a sensor: by the transforms, or to fill in.

    Parameters
    ----------
    out : Lines
    mount : Mount or None
    beside : str
        What to add where it is to fill in.
    """
    if mount is not None:
        out.say(mount.source_text, 2)
        out.put(f'lever_b: {mount.lever_text}', 2)
        return
    out.say(f'where it sits from base_link, x forward, y left, z up [m]: FILL IN{beside}', 2)
    out.put('lever_b: [0.0, 0.0, 0.0]', 2)
