"""Names nodes that do not answer: every node says once a second that its executor turns.

A node can hang without ending: stopped by SIGSTOP, caught in a loop, waiting for a disk. At the
lockstep pace all others then wait for it, so that without a name the whole run only stands still.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from .node_process import NodeProcess

SILENT_S, LOST_S = 10.0, 60.0
"""Wall time without a word after which a node is named, and after which the run has failed."""
_ASLEEP_S = 5.0


@dataclass(frozen=True)
class Silent:
    """A node and how long it has said nothing [s]."""

    node: NodeProcess
    seconds: float

    def how(self) -> str:
        """Say how long, and why where that is known."""
        why = ': it is stopped (SIGSTOP)' if self.node.is_stopped() else ''
        return f'has not answered for {self.seconds:.0f} s{why}'


class SilenceWatch:
    """Who has not been heard for how long.

    Nodes that never spoke are left out: a first start compiles for minutes.
    """

    def __init__(self) -> None:
        self._named: set[str] = set()
        self._looked_at: float | None = None
        self._since = 0.0

    def look(
        self, now_s: float, nodes: Iterable[NodeProcess]
    ) -> tuple[list[tuple[str, str]], Silent | None]:
        """Names with what became of them, silent or not any more; and the node that is lost.

        Parameters
        ----------
        now_s : float
            Monotonic time; called several times a second. After a pause of this process itself
            (Ctrl-Z, a sleeping computer) all nodes are given time anew.
        nodes : iterable of NodeProcess
            Those that run.
        """
        if self._looked_at is None or now_s - self._looked_at > _ASLEEP_S:
            self._since = now_s
        self._looked_at = now_s
        said: list[tuple[str, str]] = []
        lost: Silent | None = None
        silent = [
            Silent(node, now_s - max(node.heard_at, self._since))
            for node in nodes
            if node.heard_at is not None and node.process.poll() is None
        ]
        for one in sorted(silent, key=lambda s: -s.seconds):
            title = one.node.spec.title
            if one.seconds < SILENT_S:
                if title in self._named:
                    self._named.discard(title)
                    said.append((title, 'answers again'))
                continue
            if title not in self._named:
                self._named.add(title)
                said.append((title, one.how()))
            if one.seconds >= LOST_S and lost is None:
                lost = one
        return said, lost
