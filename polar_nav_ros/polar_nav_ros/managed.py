"""A managed node (lifecycle, REP-2011 states of rclpy) that starts by itself, unless asked not to.

| state | what the node does |
| --- | --- |
| unconfigured | nothing: it has no subscriptions of sensors |
| inactive | navigates and publishes its record; what others steer by is silent |
| active | all |

With `autostart`, the default, it is active once it is constructed. Navigation never stops but with
the process: a cleanup is refused.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, TypeVar

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState
from rclpy.lifecycle import TransitionCallbackReturn as Return

from polar_nav_core.errors import PolarNavError
from polar_nav_core.params import NodeParams

from .node import PolarNode

P = TypeVar('P', bound=NodeParams)

_LAST_WORDS_S = 0.1
"""From a shutdown to the end of the process: the answer to the service call goes out before."""
_STEADY = Clock(clock_type=ClockType.STEADY_TIME)


class ManagedNode(LifecycleNodeMixin, PolarNode[P]):  # type: ignore[misc]
    """A `PolarNode` with the services and the topic of a lifecycle node.

    Parameters
    ----------
    name : str
    params_cls : type
        As of `PolarNode`.
    """

    def __init__(self, name: str, params_cls: type[P]) -> None:
        PolarNode.__init__(self, name, params_cls)
        LifecycleNodeMixin.__init__(self)
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self.blamed(self._on_change_state)
        self._begun = False

    @abstractmethod
    def begin(self) -> None:
        """Begin to work, with outputs silent."""

    @abstractmethod
    def silence(self, silent: bool) -> None:
        """Silence the outputs that others steer by, or let them be heard."""

    @property
    def lifecycle(self) -> str:
        """Name of the state, as unconfigured, inactive or active."""
        return str(self._state_machine.current_state[1])

    def start(self, *, active: bool) -> None:
        """Go to active at once, or wait for the transitions; what `begin` raises is passed on."""
        if not active:
            self.get_logger().info('unconfigured: waiting for the transition configure')
            return
        self.begin()
        self._begun = True
        self.trigger_configure()
        self.trigger_activate()

    def _on_change_state(self, request: Any, response: Any) -> Any:  # noqa: ANN401 - ChangeState
        """Refuse a transition that the present state has not; rclpy raises, and the node ends."""
        wanted = request.transition
        possible = {
            number: label for number, label, *_ in self._state_machine.available_transitions
        }
        known = wanted.label in possible.values() if wanted.label else wanted.id in possible
        if known:
            return self._change_state(request, response)
        there = ', '.join(f'{label} ({number})' for number, label in possible.items()) or 'none'
        self.get_logger().warning(
            f'transition {wanted.label or wanted.id} is refused: from {self.lifecycle} there is '
            f'{there}'
        )
        response.success = False
        return response

    def on_configure(self, _state: LifecycleState) -> Return:
        """Begin to work; parameters that are refused end the process with status 2."""
        if self._begun:
            return Return.SUCCESS
        try:
            self.begin()
        except PolarNavError as error:
            self.get_logger().error(str(error))
            self._end(2)
            return Return.FAILURE
        self._begun = True
        return Return.SUCCESS

    def on_activate(self, _state: LifecycleState) -> Return:
        """Let all outputs be heard."""
        self.silence(False)
        return Return.SUCCESS

    def on_deactivate(self, _state: LifecycleState) -> Return:
        """Silence the outputs; the work goes on."""
        self.silence(True)
        return Return.SUCCESS

    def on_cleanup(self, _state: LifecycleState) -> Return:
        """Refuse: it would end the navigation."""
        self.get_logger().error(
            'cleanup is refused: navigation goes on until the process ends; shutdown ends it, '
            '~/reset starts it anew'
        )
        return Return.FAILURE

    def on_shutdown(self, _state: LifecycleState) -> Return:
        """End the process in order."""
        self._end(0)
        return Return.SUCCESS

    def _end(self, status: int) -> None:
        def leave() -> None:
            self.ended = status

        self.create_timer(_LAST_WORDS_S, leave, clock=_STEADY)
