"""`polar delay-budget`: how much history a follower needs."""

from __future__ import annotations

import inspect
import sys
from dataclasses import fields
from typing import Annotated, Any

import typer

from .app import app, emit_json, require, say

_EXAMPLES = (
    'Example: `./polar delay-budget --range 5000 --bit-rate 300 --retries 1`'
    '\n\nFor the follower: `./polar delay-budget --range 5000 --yaml > follower.yaml`'
)


def _delay_budget(
    *,
    as_yaml: Annotated[
        bool, typer.Option('--yaml', help='Print only the parameters, as a ROS 2 parameter file.')
    ] = False,
    as_json: Annotated[
        bool, typer.Option('--json', help='Print figures as JSON on stdout.')
    ] = False,
    **values: Any,  # noqa: ANN401 - numbers, one option each
) -> None:
    """Estimate how old a fix can get on its way, and the history and limits a follower needs.

    From distance, sound speed, packet, turn-around, processing, retries: the defaults are those of
    the nodes.
    """
    from ..why.delay_budget import LinkBudget, delay_budget

    if as_yaml and as_json:
        raise typer.BadParameter('--yaml and --json exclude each other')
    link = LinkBudget(**values)
    result = delay_budget(link)
    if as_json:
        emit_json({'ok': not result.problems, **result.to_dict()})
    elif as_yaml:
        sys.stdout.write('' if result.problems else result.yaml())
    else:
        _print(result, link)
    for problem in result.problems:
        say(problem)
    require(not result.problems)


def _print(result: Any, link: Any) -> None:  # noqa: ANN401 - types of a module that is loaded late
    from rich.console import Console

    from ..terminal.tables import print_table

    print_table(Console(highlight=False), result.table())
    sys.stdout.write(
        f'From the ping to the fix in use: {result.cycle_s:.3f} s.'
        f' Fixes under way at once: {result.pending} (every'
        f' {link.fix_period_s * link.followers:g} s to each follower).\n'
    )
    if result.channel_share > 1.0:
        sys.stdout.write(
            f'Pings and packets fill {100 * result.channel_share:.0f} % of the time between two'
            ' fixes: they overlap in the water, or the fix period must be longer.\n'
        )
    if not result.problems:
        sys.stdout.write(f'\nTo set in the follower:\n\n{result.yaml()}')


def _with_all_options() -> typer.Typer:
    """Make the command with one option per field of LinkBudget: name, default, range and text."""
    from ..why.delay_budget import LinkBudget

    keyword = inspect.Parameter.KEYWORD_ONLY
    parameters = []
    for f in fields(LinkBudget):
        m = f.metadata
        kind: Any = int if m['kind'] == 'int' else float
        name = f'--{f.name.removesuffix("_s").removesuffix("_m").replace("_", "-")}'
        unit = f' [{m["unit"]}]' if m['unit'] else ''
        option = typer.Option(
            name, min=kind(m['lo']), max=kind(m['hi']), help=f'{m["doc"]}{unit}.'
        )
        parameters.append(
            inspect.Parameter(
                f.name, keyword, default=f.default, annotation=Annotated[kind, option]
            )
        )
    own = inspect.signature(_delay_budget, eval_str=True).parameters.values()
    parameters += [p for p in own if p.kind is keyword]

    def command(**values: Any) -> None:  # noqa: ANN401 - numbers and flags
        _delay_budget(**values)

    command.__doc__ = _delay_budget.__doc__
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {p.name: p.annotation for p in parameters}
    whole = typer.Typer(
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode='markdown',
        context_settings={'help_option_names': ['-h', '--help']},
    )
    whole.command(epilog=_EXAMPLES)(command)
    return whole


@app.command(
    'delay-budget',
    help=_delay_budget.__doc__,
    add_help_option=False,
    context_settings={
        'allow_extra_args': True,
        'ignore_unknown_options': True,
        'help_option_names': [],
    },
)
def _open(context: typer.Context) -> None:
    # The nodes' parameters, which its options are made of, take a second to load: other commands
    # need not wait for them.
    _with_all_options()(args=context.args, prog_name='polar delay-budget')
