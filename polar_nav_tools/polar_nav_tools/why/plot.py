"""The small plot in the terminal: the way of the packet, then sigma and error around its use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rich.console import Group
from rich.text import Text

from .story import Story

Floats = NDArray[np.float64]

_NAME = 24
_LEVELS = ' ▁▂▃▄▅▆▇█'
_COLOURS = {
    'ping to transponder': 'bright_black',
    'turn-around': 'bright_black',
    'reply to the array': 'cyan',
    'processing': 'magenta',
    'bits': 'yellow',
    'packet to follower': 'cyan',
    'detection and the rest': 'magenta',
    'transmission': 'yellow',
}


def plot(story: Story, width: int = 80) -> Group:
    """Lines of the plot for a terminal of `width` columns."""
    parts: list[Text] = []
    if story.legs:
        parts += _way(story, width)
    parts += _around(story, width)
    return Group(*parts)


def _way(s: Story, width: int) -> list[Text]:
    start = min(leg.start_ns for leg in s.legs)
    stop = max(leg.stop_ns for leg in s.legs)
    columns = max(20, width - _NAME - 11)
    scale = columns / max(stop - start, 1)
    rows = [Text('The way of the packet', style='bold')]
    for leg in s.legs:
        a = min(round((leg.start_ns - start) * scale), columns - 1)
        b = min(max(round((leg.stop_ns - start) * scale), a + 1), columns)
        row = Text(f'{leg.name:<{_NAME}.{_NAME}}')
        row.append(' ' * a)
        row.append('━' * (b - a), style=_COLOURS.get(leg.name, ''))
        row.append(' ' * (columns - b))
        row.append(f' {leg.seconds:7.3f} s')
        rows.append(row)
    rows.append(_ruler(s, start, scale, columns))
    return rows


def _ruler(s: Story, start: int, scale: float, columns: int) -> Text:
    """Line of marks below the bars: t1 ping, t3 validity, t4 return, tx, rx."""
    marks = {}
    if s.measured is not None:
        marks = {'t1': s.measured.ping_ns, 't3': s.measured.validity_ns}
        marks['t4'] = s.measured.return_ns
    elif s.broadcast is not None:
        marks = {'t3': s.broadcast.validity_ns, 't4': s.broadcast.return_ns}
    packet = s.copy.packet if s.copy is not None else s.sent[0] if s.sent else None
    if packet is not None:
        marks['tx'] = packet.transmit_ns
    if s.copy is not None:
        marks['rx'] = s.copy.packet.receive_ns
    line = [' '] * (columns + 4)
    for name, stamp_ns in marks.items():
        at = min(max(round((stamp_ns - start) * scale), 0), columns)
        if all(c == ' ' for c in line[max(at - 1, 0) : at + 3]):
            line[at : at + 2] = list(name)
    return Text(' ' * _NAME + ''.join(line).rstrip(), style='bright_black')


def _around(s: Story, width: int) -> list[Text]:
    a = s.around
    if len(a.stamp_ns) < 2:
        return []
    columns = max(20, width - _NAME - 11)
    edges = np.linspace(a.stamp_ns[0], a.stamp_ns[-1] + 1, columns + 1)
    span = (a.stamp_ns[[0, -1]] - s.zero_ns) * 1e-9
    title = f'2-D error and sigma, {span[0]:.1f} to {span[1]:.1f} s'
    rows = [Text(), Text(title if a.error.size else title.replace('error and ', ''), style='bold')]
    for name, values, colour in (
        ('true error', a.error, 'red'),
        ('sigma', a.sigma, 'blue'),
    ):
        finite = values[np.isfinite(values)]
        if not finite.size:
            continue
        row = Text(f'{name + f", to {finite.max():.2f} m":<{_NAME}.{_NAME}}')
        row.append(_spark(a.stamp_ns, values, edges, float(finite.max())), style=colour)
        rows.append(row)
    marks = [' '] * columns
    for stamp_ns in a.received_ns:
        _set(marks, edges, int(stamp_ns), '·')
    if s.validity_ns is not None:
        _set(marks, edges, s.validity_ns, 'v')
    for copy in s.copies:
        _set(marks, edges, copy.packet.receive_ns, '▲' if copy.verdict == 'FUSED' else 'x')
    rows.append(Text(' ' * _NAME + ''.join(marks).rstrip()))
    rows.append(
        Text(
            ' ' * _NAME + 'v valid  ▲ used  x refused  · other fixes used',
            style='bright_black',
        )
    )
    return rows


def _spark(stamp_ns: NDArray[np.int64], values: Floats, edges: Floats, top: float) -> str:
    """Line of one block per column, as high as its largest value; blank without a value."""
    place = np.clip(np.searchsorted(edges, stamp_ns, side='right') - 1, 0, len(edges) - 2)
    out = []
    for k in range(len(edges) - 1):
        here = values[place == k]
        here = here[np.isfinite(here)]
        if not here.size:
            out.append(' ')
        else:
            out.append(_LEVELS[max(1, round(8 * float(here.max()) / top))] if top > 0.0 else '▁')
    return ''.join(out)


def _set(marks: list[str], edges: Floats, stamp_ns: int, mark: str) -> None:
    place = int(np.searchsorted(edges, stamp_ns, side='right')) - 1
    if 0 <= place < len(marks):
        marks[place] = mark
