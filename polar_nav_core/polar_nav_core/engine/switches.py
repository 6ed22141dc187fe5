"""Sensors that a crew has switched off: which messages are refused for it, and its condition."""

from __future__ import annotations

from .events import Command, CommandKind, Event
from .health.conditions import Condition, Culprit, Level
from .verdicts import Verdict

_CULPRITS = {
    'dvl/data': Culprit.DVL,
    'depth/data': Culprit.DEPTH,
    'heading/data': Culprit.HEADING,
}


class Switches:
    """Topics of sensors that are switched off, from the place of a command in the order on."""

    def __init__(self) -> None:
        self._off: set[str] = set()

    def turn(self, command: Command) -> bool:
        """Switch a sensor off or on; returns whether the command is of that kind."""
        if command.kind is CommandKind.SENSOR_OFF:
            self._off.add(command.sensor)
        elif command.kind is CommandKind.SENSOR_ON:
            self._off.discard(command.sensor)
        else:
            return False
        return True

    def refusal(self, event: Event) -> tuple[Verdict, str] | None:
        """Verdict and reason for a message of a sensor that is off; None for another one."""
        if event.topic not in self._off:
            return None
        return Verdict.SWITCHED_OFF, f'{event.topic} is switched off'

    def conditions(self) -> list[Condition]:
        """A WARN that names the sensors that are off."""
        if not self._off:
            return []
        culprit = Culprit.NONE
        for topic in self._off:
            culprit |= _CULPRITS.get(topic, Culprit.FIXES)
        sentence = f'switched off by a service call: {", ".join(sorted(self._off))}'
        return [Condition('switched off', Level.WARN, culprit, sentence)]
