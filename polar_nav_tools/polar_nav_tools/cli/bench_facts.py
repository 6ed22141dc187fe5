"""What the commands of `polar bench` share: the core that they run on, and what they ran on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import have_the_machine

if TYPE_CHECKING:
    from ..scoring import Table

CoreOption = Annotated[
    int | None,
    typer.Option(
        '--core',
        metavar='N',
        help='Run on this core.',
        show_default='the last that is allowed',
    ),
]
JsonOption = Annotated[bool, typer.Option('--json', help='Print figures as JSON on stdout.')]


def one_core(processor: int | None) -> int:
    """Wait for the machine; returns the core to which this process is bound from then on."""
    from ..benchmarks import machine

    have_the_machine('measurements wait')
    return machine.pin(processor)


@contextmanager
def facts_of(
    distributions: Sequence[str] = (), core: int | None = None
) -> Iterator[dict[str, Any]]:
    """Facts of the machine and of versions, with the load before and after what is timed."""
    from ..benchmarks import machine

    facts: dict[str, Any] = {**machine.describe(distributions)}
    if core is not None:
        facts['core'] = core
    yield facts
    facts['load_average_after'] = machine.load()


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables to the terminal."""
    from rich.console import Console

    from ..terminal.tables import print_table

    console = Console(highlight=False)
    for table in tables:
        print_table(console, table)


def machine_line(facts: Mapping[str, Any], rounds: int) -> str:
    """Return the line about the machine and versions of a measurement."""
    return (
        f'{facts["cpu"]}, core {facts["core"]} of {facts["cores"]}, load'
        f' {facts["load_average"]:.1f} to {facts["load_average_after"]:.1f}, Python'
        f' {facts["python"]}, '
        + ', '.join(f'{k} {v}' for k, v in facts['versions'].items())
        + f'; medians of {rounds} rounds.\n'
    )


def cores_line(facts: Mapping[str, Any], rounds: int | None = None) -> str:
    """Return the line about the machine of a measurement on all its cores."""
    medians = '' if rounds is None else f'; medians of {rounds} rounds'
    return (
        f'{facts["cpu"]}, {facts["cores"]} cores, load {facts["load_average"]:.1f} to'
        f' {facts["load_average_after"]:.1f}, Python {facts["python"]}{medians}.\n'
    )
