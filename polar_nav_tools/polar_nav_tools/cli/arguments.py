"""Arguments and options of the commands that take a bag of any origin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

AnyBagArgument = Annotated[
    Path,
    typer.Argument(
        metavar='BAG', help='Folder of a bag, .mcap, .db3 or .bag file.', show_default=False
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
