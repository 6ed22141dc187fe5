"""`polar test`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .app import app, end, have_the_machine


@app.command(
    'test',
    epilog='Example: `./polar test --fast`\n\nOnly some tests: `./polar test -- -k supervisor`',
    context_settings={'allow_extra_args': True, 'ignore_unknown_options': True},
)
def run_tests(
    context: typer.Context,
    long: Annotated[bool, typer.Option('--long', help='The stated lengths too: hours.')] = False,
    fast: Annotated[
        bool, typer.Option('--fast', help='Only what takes seconds: no builds, no node graphs.')
    ] = False,
) -> None:
    """Check style, types and floors, then run the tests.

    Further arguments go to pytest, and then only pytest runs.
    """
    from ..development.suite import run_suite, source_root

    if long and fast:
        raise typer.BadParameter('--long and --fast exclude each other')
    root = source_root(Path.cwd())
    have_the_machine('tests wait')  # one that waits by itself may come to the end of its time
    end(run_suite(root, long=long, fast=fast, arguments=context.args))
