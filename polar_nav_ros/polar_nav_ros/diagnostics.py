"""Health of a node, published once a second on /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Diagnosis:
    """One status: level, one sentence, and the numbers behind it."""

    level: Level = Level.OK
    message: str = 'running'
    values: Mapping[str, object] = field(default_factory=dict)

    def to_msg(self, name: str, vehicle: str) -> DiagnosticArray:
        """diagnostic_msgs/DiagnosticArray with one status; the publisher sets the stamp.

        ``name`` is the node's, ``vehicle`` the hardware that it runs on.
        """
        pairs = [KeyValue(key=str(k), value=str(v)) for k, v in self.values.items()]
        status = DiagnosticStatus(
            level=bytes([self.level]),
            name=name,
            message=self.message,
            hardware_id=vehicle,
            values=pairs,
        )
        return DiagnosticArray(status=[status])
