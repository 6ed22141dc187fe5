"""Health of a node, published once a second on /diagnostics."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

_NUMBER = re.compile(r'[+-]?\d[\d.]*')


def without_numbers(sentence: str) -> str:
    """What a sentence says, whatever its numbers: they change with each second."""
    return _NUMBER.sub('#', sentence)


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

    def beside(self, *sentences: str) -> Diagnosis:
        """The same with further sentences, at least a WARN; empty ones say nothing."""
        said = [text for text in sentences if text]
        if not said:
            return self
        message = '; '.join([self.message, *said])
        return replace(self, level=max(self.level, Level.WARN), message=message)

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
