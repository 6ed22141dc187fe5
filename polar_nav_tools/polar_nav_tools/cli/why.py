"""`polar why`: the story of one acoustic fix."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, require, say
from .bags import BagArgument, JsonOption, VehicleOption
from .choices import CONFIGURATIONS

if TYPE_CHECKING:
    from ..why import Story


@app.command(
    epilog='Example: `./polar why bags/my_run --seq 7`'
    '\n\nWith the other filter, and a picture: '
    '`./polar why bags/my_run --seq 7 -c conventional_akf --figure 7.png`'
)
def why(
    bag: BagArgument,
    seq: Annotated[
        int, typer.Option('--seq', '-n', min=0, help='Number of the fix.', show_default=False)
    ],
    source: Annotated[
        str | None, typer.Option('--source', help='Its leader, when the bag has several.')
    ] = None,
    configuration: Annotated[
        str | None,
        typer.Option(
            '--configuration',
            '-c',
            metavar='NAME',
            help=f'Replay with this filter instead of the recorded: {", ".join(CONFIGURATIONS)}.',
        ),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option('--figure', help='Write the picture too, as .png or .svg.')
    ] = None,
    vehicle: VehicleOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the story of one fix: its times, the parts of its delay, its verdict, its effect."""
    from ..analysis.opening import follower_of, open_for
    from ..replay.recorded import followers_of
    from ..why import load_records, story_of

    source_bag = open_for(bag, say)
    name = vehicle or follower_of(source_bag)
    params = followers_of(source_bag).get(name, {})
    records = load_records(source_bag, name, configuration, params=params)
    story = story_of(records, seq, source)
    if figure is not None:
        from ..why.figure import write_figure

        write_figure(figure, story)
    if as_json:
        from ..why.document import document

        said = {'ok': not source_bag.problems, 'path': str(source_bag.path)}
        emit_json({**said, **document(story)})
    else:
        _print(story)
        if figure is not None:
            sys.stdout.write(f'\n{figure}\n')
    require(not source_bag.problems)


def _print(story: Story) -> None:
    from rich.console import Console
    from rich.padding import Padding
    from rich.text import Text

    from ..why.plot import plot
    from ..why.words import headline, paragraphs

    console = Console(highlight=False)
    whole = not console.is_terminal  # a file has no edge
    console.print(Text(headline(story), style='bold'), soft_wrap=whole)
    if story.replayed:
        console.print(Text(f'By a replay with {story.configuration}.'))
    for title, sentences in paragraphs(story):
        console.print(Text(f'\n{title}', style='bold'))
        for sentence in sentences:
            if whole:
                console.print(Text(f'  {sentence}'), soft_wrap=True)
            else:
                console.print(Padding(Text(sentence), (0, 0, 0, 2)))
    console.print()
    console.print(plot(story, min(console.width, 100)))
