"""`polar score BAG --withhold`: what the filter predicts of measurements that it never got."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from polar_nav_core.errors import ConfigError

from .app import emit_json, require, say
from .mapped import open_mapped

if TYPE_CHECKING:
    from polar_nav_core.engine.inputs import Inputs
    from polar_nav_follower.params import FollowerParams

    from ..replay.withhold import Predicted
    from ..scoring.withheld import WithheldScore


def score_withheld(
    bag: Path,
    texts: Sequence[str],
    seed: int,
    configurations: Sequence[str],
    mapping: Path | None,
    vehicle: str | None,
    as_json: bool,
) -> None:
    """Replay a bag without some measurements and print how well they are predicted."""
    from rich.console import Console

    from ..replay.withhold import parse, withhold
    from ..scoring.withheld import withheld_table
    from ..terminal.tables import print_table

    what = [parse(text) for text in texts]
    scores: dict[str, list[WithheldScore]] = {}
    stopped: dict[str, str] = {}
    for name in configurations or ('default',):
        params, inputs, problems = (
            _recorded(bag, name, vehicle) if mapping is None else _foreign(bag, mapping, name)
        )
        found, divergence = withhold(params, inputs, what, seed)
        scores[name] = [one for predicted in found for one in _scored(predicted)]
        if divergence:
            stopped[name] = divergence
    if as_json:
        emit_json(
            {
                'ok': not (stopped or problems),
                'path': str(bag),
                'seed': seed,
                'divergence': stopped,
                'withheld': {n: [one.to_dict() for one in f] for n, f in scores.items()},
            }
        )
    else:
        print_table(Console(highlight=False), withheld_table(scores))
    for name, why in stopped.items():
        say(f'{name} diverged: {why}')
    require(not (stopped or problems))


def _recorded(
    bag: Path, configuration: str, vehicle: str | None
) -> tuple[FollowerParams, Inputs, list[str]]:
    from polar_nav_core.engine.inputs import Inputs

    from ..analysis.opening import open_for
    from ..replay.arrays_from_bag import load_arrays
    from ..replay.by_message import parameters

    source = open_for(bag, say)
    arrays = load_arrays(source, vehicle)
    params = None if arrays is None else parameters(arrays.params, configuration, {})
    inputs = None if arrays is None or params is None else arrays.inputs(params)
    numbered = getattr(inputs, 'inputs', None)
    if params is None or not isinstance(numbered, Inputs):
        raise ConfigError(
            f'{bag}: --withhold takes runs of a SINS without a vehicle model, on topics of this '
            'project; of a run with sources state its mapping: --map FILE'
        )
    return params, numbered, list(source.problems)


def _foreign(
    bag: Path, mapping_path: Path, configuration: str
) -> tuple[FollowerParams, Inputs, list[str]]:
    from ..foreign.lever import at_the_imu
    from ..foreign.load import load

    source, what = open_mapped(bag, mapping_path, {'configuration': configuration})
    loaded = load(source, what, ())
    return at_the_imu(loaded), loaded.inputs, list(source.problems)


def _scored(one: Predicted) -> list[WithheldScore]:
    """Scores of one kind; of fixes the horizontal part, and apart the heights that they have."""
    from ..replay.withhold import DVL, FIXES
    from ..scoring.withheld import withheld_score

    what, e, S = one.withheld.text, one.error, one.covariance
    if one.withheld.kind == FIXES:
        level = withheld_score(f'{what}, horizontal', 'm', one.offered, e[:, :2], S[:, :2, :2])
        high = ~one.level
        if not high.any():
            return [level]
        up = withheld_score(f'{what}, up', 'm', one.offered, e[high, 2:], S[high, 2:, 2:])
        return [level, up]
    unit = 'm/s' if one.withheld.kind == DVL else 'm'
    return [withheld_score(what, unit, one.offered, e, S)]
