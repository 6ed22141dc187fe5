"""`experiment NAME [options]`, as it was spelled before there were subcommands.

To be deleted, with its use in `experiments`, one release after the subcommands came.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence

NAMES = (
    'table1',
    'table2',
    'table3',
    'figure8',
    'figure9',
    'figure11',
    'ablation',
    'consistency',
    'mismatch',
    'faults',
    'leader-error',
    'spoof',
    'calibrate',
    'tune',
    'smooth',
    'smooth-mismatch',
    'combined-imu',
    'late',
    'price',
    'mems',
    'quiet',
    'aiding',
    'bluerov2',
    'has-table',
    'has-figures',
    'has-loss',
    'has-current',
    'has-excitation',
    'has-heading',
    'has-delay',
)
"""Names of `experiments.catalog`, stated here for the help: that module takes a second to load."""

WITH_IMU = ('table3', 'figure11')
"""Experiments that can be run with recorded errors of an IMU."""

_COMMANDS = ('run', 'ablation', 'mismatch', 'faults', 'imu-errors', 'list')
_FLAGS = ('--quick', '--json', '-h', '--help')
_IMU = '--imu-'


def today(arguments: Sequence[str]) -> list[str]:
    """Return the arguments as they are spelled today; unchanged if they are no old spelling."""
    same = list(arguments)
    if same and same[0] in _COMMANDS:
        return same
    if '--list' in same:
        return ['list']
    names, options = _split(same)
    if len(names) != 1 or names[0] not in NAMES:
        return same
    name = names[0]
    bag = next((o[1] for o in options if o[0] == '--imu-errors' and len(o) == 2), None)
    if bag is None or name == 'ablation':
        first = [name] if name == 'ablation' else ['run', name]
    else:
        first = ['imu-errors', bag, *([] if name == 'table3' else ['--experiment', name])]
        options = [
            ['--' + o[0].removeprefix(_IMU), *o[1:]] if o[0].startswith(_IMU) else o
            for o in options
            if o[0] != '--imu-errors'
        ]
    return [*first, *(word for option in options for word in option)]


def _split(arguments: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    """Names, and options each with its value: the old command took both in any order."""
    names: list[str] = []
    options: list[list[str]] = []
    rest = iter(arguments)
    for word in rest:
        if not word.startswith('-'):
            names.append(word)
        elif '=' in word:
            options.append(word.split('=', 1))
        elif word in _FLAGS:
            options.append([word])
        else:
            options.append([word, *([value] if (value := next(rest, None)) is not None else [])])
    return names, options


def hint(spelling: Sequence[str]) -> str:
    """Return the sentence for who uses the old spelling."""
    return (
        f'spelled `./polar experiment {shlex.join(spelling)}` now; '
        'the old spelling goes with the next release'
    )
