"""Reference pages made from the code: parameters, fields of the acoustic packet, rooms and floors.

``python -m polar_nav_tools.development.pages docs`` writes them; a test compares them with the
code.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

from polar_nav_core.link import packet, station_packet
from polar_nav_follower.params import FollowerParams
from polar_nav_leader.params import LeaderParams
from polar_nav_ros.modem_bridge import BridgeParams
from polar_nav_sim import params as sim

from ..record.params import RecorderParams
from . import house
from .follower_groups import FIRST, groups

NODES: dict[str, type[Any]] = {
    'truth_node': sim.TruthParams,
    'vehicle_node': sim.VehicleParams,
    'imu_node': sim.ImuParams,
    'dvl_node': sim.DvlParams,
    'depth_node': sim.DepthParams,
    'ahrs_node': sim.AhrsParams,
    'usbl_node': sim.UsblParams,
    'station_node': sim.StationParams,
    'leader_reference_node': sim.LeaderReferenceParams,
    'absolute_fix_node': sim.AbsoluteFixParams,
    'acoustic_link_node': sim.AcousticLinkParams,
    'leader_node': LeaderParams,
    'follower_node': FollowerParams,
    'modem_bridge': BridgeParams,
    'recorder_node': RecorderParams,
}

_FOLLOWER = 'follower_node'
_WARNING = (
    '<!-- Made by `python -m polar_nav_tools.development.pages docs`; edit the code instead. -->'
)


def parameters_page() -> str:
    """Markdown page of all parameters of all nodes."""
    parts = [
        '# Parameters',
        _WARNING,
        'All are read-only: a node is started with them. An unknown name, a wrong type or a value '
        'out of range stops the node at the start with a sentence that names it.',
        f'For a vehicle of yours: [the {len(FIRST)} that matter first]'
        f'(#the-{len(FIRST)}-that-matter-first), the others of the follower behind them by group.',
    ]
    for node, cls in NODES.items():
        parts.append(f'## {node}')
        parts += _follower() if node == _FOLLOWER else [_table(fields(cls))]
    return '\n\n'.join(parts) + '\n'


def packet_page() -> str:
    """Markdown page of the layout of the acoustic packets."""
    parts = [
        '# Acoustic packets',
        _WARNING,
        'Little-endian; the first byte is the format and tells which packet it is. Standard '
        'deviations are rounded up. Times are ticks of 0.1 ms that wrap.',
        f'## From a leader: format {packet.VERSION}, {packet.SIZE} bytes',
        packet.documentation(),
        f'## From a station: format {station_packet.VERSION}, {station_packet.SIZE} bytes',
        station_packet.documentation(),
        't4, when the reply was back at the station, is t3 + range / sound_speed.',
    ]
    return '\n\n'.join(parts) + '\n'


def house_figure() -> str:
    """SVG figure of the rooms and floors of this clone."""
    return house.drawing(Path(__file__).parents[3])


def write(folder: Path) -> None:
    """Write the pages and the figure into a folder of documents."""
    (folder / 'parameters.md').write_text(parameters_page(), encoding='utf-8')
    (folder / 'packet.md').write_text(packet_page(), encoding='utf-8')
    (folder / 'figures' / 'house.svg').write_text(house_figure(), encoding='utf-8')


def _follower() -> list[str]:
    """Parts of the follower's section: the parameters that matter first, the others by group."""
    every = {f.name: f for f in fields(FollowerParams)}
    rows = ['| name | default | unit | range | meaning | what hangs on it |']
    rows.append('| --- | --- | --- | --- | --- | --- |')
    rows += [f'{_row(every[name])} {why} |' for name, why in FIRST.items()]
    parts = [
        f'### The {len(FIRST)} that matter first',
        'Most are stated by the mapping file, by class of instrument or from the data sheet '
        '([your-vehicle.md](your-vehicle.md#4-from-the-data-sheet-to-the-file)). The defaults are '
        'those of the published vehicle.',
        '\n'.join(rows),
    ]
    for title, some in groups(every.values()).items():
        parts += [f'### {title}', _table(some)]
    return parts


def _table(parameters: Iterable[Field[Any]]) -> str:
    rows = ['| name | default | unit | range | meaning |', '| --- | --- | --- | --- | --- |']
    return '\n'.join([*rows, *map(_row, parameters)])


def _row(f: Field[Any]) -> str:
    meta = f.metadata
    default = list(f.default) if isinstance(f.default, tuple) else f.default
    span = ', '.join(meta['options']) if 'options' in meta else ''
    if 'lo' in meta:
        span = f'{meta["lo"]:g} to {meta["hi"]:g}'
    text = f'`{default}`' if default != '' else ''
    return f'| `{f.name}` | {text} | {meta["unit"]} | {span} | {meta["doc"]} |'


if __name__ == '__main__':
    write(Path(sys.argv[1]))
