"""`polar score`: one bag or several, one configuration or several, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app, emit_json, require, say
from .bags import (
    ConfigurationsOption,
    JsonOption,
    SmoothOption,
    TruthOption,
    VehicleOption,
    ahead_of,
    analysed,
    print_complaints,
)
from .experiments import Scheduler

if TYPE_CHECKING:
    from ..analysis.analyse import Analysis


@app.command(
    epilog='Example: `./polar score bags/my_run`'
    '\n\nOnly what was recorded live: `./polar score bags/my_run --recorded`'
    '\n\nFilter and smoother: `./polar score bags/my_run --configs default --smooth`'
    '\n\nWithout a truth: `./polar score bags/my_run --withhold fixes:50% --withhold dvl:60s`'
    '\n\nSide by side: `./polar score bags/a bags/b --configs conventional_akf modified_akf '
    'default --markdown scores.md --csv scores.csv`'
    "\n\nA fleet: `./polar score 's3://fleet/**/*.mcap' --configs default --out scores.parquet "
    '--resume`, docs/scale.md'
)
def score(
    bags: Annotated[
        list[Path],
        typer.Argument(
            metavar='BAG...',
            help='Bags: folders, .mcap files, addresses (s3://, https://), patterns of these.',
            show_default=False,
        ),
    ],
    configuration: ConfigurationsOption = None,
    configs: Annotated[
        list[str] | None,
        typer.Option('--configs', help='Several configurations: --configs A B C, or A,B,C.'),
    ] = None,
    recorded: Annotated[
        bool, typer.Option('--recorded', help='Score the recorded estimates and replay nothing.')
    ] = False,
    smooth: SmoothOption = False,
    truth: TruthOption = None,
    vehicle: VehicleOption = None,
    markdown: Annotated[
        Path | None, typer.Option('--markdown', help='Write the tables as Markdown, too.')
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option('--csv', help='Write every number, unrounded: table, run, figure, value.'),
    ] = None,
    withhold: Annotated[
        list[str] | None,
        typer.Option(
            '--withhold',
            metavar='WHAT',
            help='Keep measurements from the filter and predict them: fixes:50%, dvl:60s, '
            'depth:30s; may be repeated. Needs no truth.',
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option('--seed', min=0, help='With --withhold: of the random share.')
    ] = 1,
    mapping: Annotated[
        Path | None,
        typer.Option('--map', help="With --withhold: what is what in someone else's bag."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            '--out',
            '-o',
            metavar='FILE.parquet',
            help='Keep a row for each bag and configuration, made by tasks.',
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option('--resume', help='With --out: make only the rows that are missing.')
    ] = False,
    failed: Annotated[
        bool, typer.Option('--failed', help='With --out: make those again, too, that failed.')
    ] = False,
    jobs: Annotated[
        int | None,
        typer.Option(
            metavar='N', help='With --out: processes of this machine.', show_default='all cores'
        ),
    ] = None,
    scheduler: Scheduler = None,
    as_json: JsonOption = False,
) -> None:
    """Compare estimates with the truth: errors, what the delay costs, honesty of the covariance.

    Replays each bag with both filters of the paper, or with the configurations that are named.
    """
    from ..analysis.opening import open_for
    from ..analysis.score_files import (
        label_bags,
        side_by_side,
        tables_of,
        write_csv,
        write_markdown,
    )
    from ..fleet.named import expanded

    words, named = _apart(bags, configs or [])
    chosen = [*(configuration or []), *named]
    if out is not None:
        if recorded or smooth or truth or withhold or mapping:
            raise typer.BadParameter(
                'goes without --recorded, --smooth, --truth, --withhold and --map',
                param_hint='--out',
            )
        from .fleet import order_of, score_fleet

        order = order_of(words, chosen, out, vehicle, (jobs, scheduler), (resume, failed))
        score_fleet(order, markdown, csv, as_json)
        return
    if resume or failed or jobs is not None or scheduler is not None:
        raise typer.BadParameter('--resume, --failed, --jobs and --scheduler go with --out')
    found = expanded(words)
    if withhold:
        from .withhold import score_withheld

        if len(found) != 1:
            raise typer.BadParameter('--withhold takes one bag')
        score_withheld(found[0], withhold, seed, chosen, mapping, vehicle, as_json)
        return
    if mapping is not None:
        raise typer.BadParameter('--map goes with --withhold; `polar replay --map` scores too')
    analyses: dict[str, Analysis] = {}
    named_bags = label_bags(found)
    for label, bag in named_bags.items():
        source = open_for(bag, say, ahead_of(recorded, truth, vehicle))
        analyses[label] = analysed(source, chosen, recorded, truth, vehicle, smooth)
    comparison = side_by_side({label: a.comparison for label, a in analyses.items()})
    tables = tables_of(comparison, analyses)
    if markdown is not None:
        write_markdown(markdown, tables)
    if csv is not None:
        write_csv(csv, tables)
    if as_json:
        emit_json(_document(analyses, named_bags))
    else:
        from rich.console import Console

        from ..terminal.tables import print_table

        console = Console(highlight=False)
        for table in tables:
            print_table(console, table)
    well = [print_complaints(analysis) for analysis in analyses.values()]
    require(all(well))


def _apart(words: list[Path], configs: list[str]) -> tuple[list[Path], list[str]]:
    """Bags and configurations: after ``--configs A`` further names may follow."""
    from polar_nav_core.engine.configurations import NAMES

    names = [name for text in configs for name in text.split(',') if name]
    if not names:
        return words, names
    further = [p for p in words if str(p) in NAMES and not p.exists()]
    bags = [p for p in words if p not in further]
    if not bags:
        raise typer.BadParameter('no bag is named')
    return bags, [*names, *map(str, further)]


def _document(analyses: Mapping[str, Analysis], paths: Mapping[str, Path]) -> dict[str, object]:
    """JSON document of the scores of one bag, or of several by name."""
    said: dict[str, dict[str, object]] = {
        label: {
            'ok': not one.complaints(),
            'path': str(paths[label]),
            'vehicle': one.vehicle,
            'runs': one.comparison.to_dict(),
            'packets': None if one.delivery is None else one.delivery.to_dict(),
            'complaints': one.complaints(),
            'remarks': one.remarks(),
            'health': {name: span.to_dict() for name, span in one.spans.items()},
            'judged': list(one.judged),
        }
        for label, one in analyses.items()
    }
    if len(said) == 1:
        return next(iter(said.values()))
    return {'ok': all(one['ok'] for one in said.values()), 'bags': said}
