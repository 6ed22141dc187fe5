"""Arguments and options of the commands that take a bag of any origin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from polar_nav_core.errors import ConfigError


def existing(bag: Path) -> Path:
    """Path of a bag that exists; checked before a command loads what reads it.

    One at an address is asked for once, when it is opened.
    """
    if ':/' in str(bag):  # what reads bags loads slowly, and most are here
        from ..bags.remote.address import bag_path, is_remote

        bag = bag_path(bag)
        if is_remote(bag):
            return bag
    try:
        there = bag.exists()
    except OSError as error:
        raise ConfigError(f'{bag}: cannot be read ({error.strerror})') from error
    if not there:
        raise ConfigError(f'{bag} does not exist')
    return bag


AnyBagArgument = Annotated[
    Path,
    typer.Argument(
        metavar='BAG',
        help='Folder of a bag, .mcap, .db3 or .bag file; s3:// or https:// (MCAP).',
        show_default=False,
        callback=existing,
    ),
]
MaybeBagArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar='[BAG]',
        help='Folder of a bag, .mcap, .db3 or .bag file; s3:// or https:// (MCAP).',
        show_default=False,
        callback=lambda bag: None if bag is None else existing(bag),
    ),
]
MsgPathOption = Annotated[
    Path | None,
    typer.Option(
        '--msg-path',
        metavar='DIR',
        help='Folder with .msg files of types that the bag does not describe.',
        show_default=False,
    ),
]
ChangeOption = Annotated[
    list[str] | None,
    typer.Option('--set', metavar='NAME=VALUE', help='Change a follower parameter.'),
]
MapOption = Annotated[
    Path | None,
    typer.Option('--map', help="What is what in someone else's bag: YAML, see `polar map`."),
]
AcceptOption = Annotated[
    list[str] | None,
    typer.Option('--accept', metavar='FINDING', help='With --map: take such data as is.'),
]
