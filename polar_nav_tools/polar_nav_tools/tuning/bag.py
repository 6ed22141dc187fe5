"""Tunes the follower of a bag, of this project or mapped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from polar_nav_ros.adapters.mapping import Mapping as Sources

from ..bags import Bag
from ..foreign.recording import Progress, Recording, mapped_recording, own_recording
from ..foreign.sources import Source
from ..scoring.json_values import jsonable
from .estimate import Tuned, tune
from .judge import BAND
from .verdicts import Line, lines_of, notes, problems, sentence


@dataclass(frozen=True, eq=False)
class Tuning:
    """Noise of one recording, with verdicts.

    Attributes
    ----------
    run : Recording
    found : Tuned
    lines : tuple of Line
    """

    run: Recording
    found: Tuned
    lines: tuple[Line, ...]

    @property
    def problems(self) -> list[str]:
        """Sentences on what was not well."""
        return problems(self.found)

    def to_dict(self) -> dict[str, object]:
        """Values for JSON."""
        found, judged = self.found, self.found.judged
        return {
            'ok': not self.problems,
            'path': str(self.run.path),
            'vehicle': self.run.vehicle,
            'recorded': self.run.recorded.isoformat(),
            'seconds': found.seconds,
            'parameters': [
                {
                    'name': line.parameter.name,
                    'source': line.parameter.source,
                    'unit': line.parameter.unit,
                    'stated': line.parameter.stated,
                    'found': line.value,
                    'sigma_share': jsonable(line.sigma_share),
                    'at_most': jsonable(line.at_most),
                    'verdict': str(line.verdict),
                    'refuted': line.refuted,
                    'suggested': line.suggested,
                    'changes': line.changes,
                    'why': line.why,
                    'about': line.parameter.doc,
                }
                for line in self.lines
            ],
            'imu_classes': [
                {'name': c.name, 'ln_likelihood': jsonable(c.ln_likelihood)} for c in found.classes
            ],
            'held_out': {
                'seconds': judged.seconds,
                'rows': judged.rows,
                'ln_likelihood_gain_per_row': jsonable(judged.gain),
                'its_sigma': jsonable(judged.gain_sigma),
                'verdict': judged.verdict,
                'nis': {
                    n.sensor: {
                        'rows': n.rows,
                        'stated': jsonable(n.stated),
                        'suggested': jsonable(n.suggested),
                        'band': list(n.band),
                        'band_probability': BAND,
                        'inside': n.inside,
                    }
                    for n in judged.nis
                },
                'nees': {
                    name: {quantity: c.to_dict() for quantity, c in of.items()}
                    for name, of in found.nees.items()
                    if of
                },
            },
            'instead': None if found.instead is None else found.instead.to_dict(),
            'left_out': dict(found.left_out),
            'sentence': sentence(found, self.lines),
            'problems': self.problems,
            'notes': notes(found),
        }


def tune_bag(bag: Bag, vehicle: str, *, changes: Mapping[str, Any], progress: Progress) -> Tuning:
    """Noise of a follower's own recording.

    Raises
    ------
    ConfigError
        As `own_recording` and `tune`.
    """
    run = own_recording(
        bag, vehicle, 'tuned', changes, truth=True, progress=lambda share: progress(0.1 * share)
    )
    return _tuned(run, lambda share: progress(0.1 + 0.9 * share))


def tune_mapped(
    source: Source, mapping: Sources, *, accept: Iterable[str], progress: Progress
) -> Tuning:
    """Noise of a bag of any origin; errors as `mapped_recording` and `tune`."""
    return _tuned(mapped_recording(source, mapping, accept), progress)


def _tuned(run: Recording, progress: Progress) -> Tuning:
    found = tune(run, progress)
    return Tuning(run, found, lines_of(found))
