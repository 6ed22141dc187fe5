"""The `polar` application and the common parts of its commands: errors, JSON, exit status."""

from __future__ import annotations

import importlib
import json
import os
import sys
from collections.abc import Mapping
from importlib.metadata import version
from typing import Annotated, NoReturn

import typer

from polar_nav_core import background
from polar_nav_core.errors import PolarNavError
from polar_nav_tools.terminal.garbage_collection import collect_rarely

from . import status

# Before NumPy is loaded: no command multiplies matrices worth sharing, and threads that wait for
# one another on a busy machine make a small fit a hundred times slower.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
# Nor do large arrays that are written once and read a few times gain by huge pages, for which a
# virtual machine whose host takes unused memory back pays dearly.
os.environ.setdefault('NUMPY_MADVISE_HUGEPAGE', '0')

COMMANDS = (
    'live',
    'play',
    'ros2',
    'bags',
    'score',
    'trust',
    'export',
    'smooth',
    'calibrate',
    'tune',
    'bench',
    'bench_smooth',
    'experiments',
    'campaign',
    'development',
    'why',
    'delay_budget',
    'foreign',
    'identify',
    'inject',
)
"""Modules beside this one, in the order of the help."""

app = typer.Typer(
    name='polar',
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode='markdown',
    context_settings={'help_option_names': ['-h', '--help']},
    help=(
        'Navigate a low-cost vehicle near a pole with late acoustic fixes from a leader: '
        'run, record, replay, score.'
    ),
    epilog='Example: `./polar demo`',
)


def _version(asked: bool) -> None:
    if asked:
        from polar_nav_core.engine.version import ENGINE_VERSION

        sys.stdout.write(f'polar_nav {version("polar_nav_tools")}, engine {ENGINE_VERSION}\n')
        raise typer.Exit


@app.callback()
def common(
    _: Annotated[
        bool,
        typer.Option('--version', callback=_version, is_eager=True, help='Show it and exit.'),
    ] = False,
    no_limits: Annotated[
        bool,
        typer.Option('--no-limits', help='Read bags that decompress to many times their size.'),
    ] = False,
) -> None:
    """Take the options that stand before the command."""
    if no_limits:
        from ..bags import limits

        limits.lift()


def emit_json(value: Mapping[str, object]) -> None:
    """Print one JSON document; NaN is refused, for other programs could not read it."""
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False) + '\n')


def say(text: str) -> None:
    """Print a message to stderr; stdout is for results."""
    sys.stderr.write(f'polar: {text}\n')
    sys.stderr.flush()


def have_the_machine(what: str) -> None:
    """Wait until no kernels are compiled in the background; `what` begins the line about it."""
    background.wait(what)


def end(exit_status: int) -> NoReturn:
    """End the command with this exit status (`status`)."""
    raise typer.Exit(exit_status)


def require(well: bool) -> None:
    """End the command with status 1 unless all is well."""
    if not well:
        end(status.NOT_WELL)


def main() -> int:
    """Exit status of the command line tool.

    An error that is meant for the user is one sentence; anything else is a defect and keeps its
    traceback.
    """
    collect_rarely()
    for commands in COMMANDS:
        importlib.import_module(f'{__package__}.{commands}')
    try:
        app(prog_name='polar')
        sys.stdout.flush()
    except SystemExit as ending:
        if isinstance(ending.__context__, BrokenPipeError):  # click made a status 1 of it
            return status.WELL
        return ending.code if isinstance(ending.code, int) else int(ending.code is not None)
    except PolarNavError as error:
        say(' '.join(str(error).split()))
        for line in getattr(error, 'details', ()):
            sys.stderr.write(f'  {line}\n')
        return status.of_error(error)
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            _forget_output()
        else:
            place = f'{error.filename}: ' if error.filename else ''
            say(f'{place}{error.strerror or error}')
        return status.of_error(error)
    except KeyboardInterrupt as interrupt:
        say('interrupted')
        return status.of_error(interrupt)
    return status.WELL


def _forget_output() -> None:
    """Let what is still to be written go nowhere: Python would fail on it when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
