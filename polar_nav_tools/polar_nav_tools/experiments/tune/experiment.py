"""Experiment `tune`: noise that is stated wrong, found by `./polar tune`, against the truth.

Where something else is wrong, nothing is to be suggested, and what is wrong to be named.
"""

from __future__ import annotations

import math
import re
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...calibration.verdicts import Verdict
from ...foreign.recording import Recording
from ...scoring.tables import Column, Table
from ...tuning.classes import STATED
from ...tuning.estimate import Tuned, tune
from ...tuning.verdicts import lines_of, problems
from ..experiment import Experiment
from ..jobs import RunResult
from ..request import Request, Size, rows_matching
from ..suite import one_filter_suite
from .rows import ROWS, Row

COLUMN = 'tuned'
CLOSE, SURE, SIGMAS = 0.2, 0.07, 3.0
"""A noise is back within this share of the truth, or, where the data leave more than the second,
within so many of the sigmas that they leave."""
_VERDICTS = tuple(Verdict)


@dataclass(frozen=True)
class TuneJob:
    """One run to make."""

    row: str
    duration_s: float
    seed: int
    column: str = COLUMN

    @property
    def group(self) -> str:
        """Name in tables."""
        return self.row


def plan(request: Request, size: Size, columns: Sequence[str]) -> list[TuneJob]:
    """Jobs of all rows and seeds.

    Raises
    ------
    ConfigError
        For a pattern of rows that matches none.
    """
    del columns
    return [
        TuneJob(name, size.duration_s, seed)
        for name in rows_matching(request.rows, (row.name for row in ROWS))
        for seed in range(request.first_seed, request.first_seed + size.seeds)
    ]


def run_job(job: TuneJob) -> RunResult:
    """Result of one job: found over true, sigma and verdict of each noise, and the judgement."""
    begin = time.process_time()
    row = next(r for r in ROWS if r.name == job.row)
    params, inputs, true = row.stated(job.duration_s, job.seed)
    found = tune(Recording(Path(job.row), 'follower', params, params, inputs))
    metrics = _judgement(found)
    lines = lines_of(found)
    for line in lines:
        name = line.parameter.name
        if name in true:
            metrics[f'{name}.ratio'] = line.value / true[name]
            metrics[f'{name}.sigma'] = line.sigma_share
            metrics[f'{name}.verdict'] = float(_VERDICTS.index(line.verdict))
    metrics['instead'] = float(found.instead is not None)
    metrics['suggested'] = float(sum(line.changes for line in lines))
    reason = '; '.join(problems(found))
    stopped_s = job.duration_s if reason else math.nan
    seconds = time.process_time() - begin
    return RunResult(job.group, job.column, job.seed, metrics, stopped_s, reason, {}, seconds)


def _judgement(found: Tuned) -> dict[str, float]:
    judged = found.judged
    stated = next(c.ln_likelihood for c in found.classes if c.name == STATED)
    out = {
        'held_out.gain': judged.gain,
        'held_out.better': float(judged.verdict == 'better'),
        'held_out.worse': float(judged.verdict == 'worse'),
        'class.mems': float(found.classes[0].name in ('vn100', 'bmi088', 'icm20948')),
        'class.gain': found.classes[0].ln_likelihood - stated,
    }
    for nis in judged.nis:
        out[f'nis.{nis.sensor}'] = nis.suggested
        out[f'nis.{nis.sensor}.inside'] = float(nis.inside)
    return out


def is_back(ratio: float, sigma: float) -> bool:
    """Whether a noise that was estimated came back (`CLOSE`, `SURE`, `SIGMAS`)."""
    if abs(ratio - 1.0) <= CLOSE:
        return True
    return sigma > SURE and abs(math.log(ratio)) <= SIGMAS * sigma


_NOISES = (
    Column('group', 'stated wrong'),
    Column('name', 'noise'),
    Column('factor', 'stated / true'),
    Column('ratio', 'found / true', doc='geometric mean of those that are ESTIMATED'),
    Column('rms', 'RMS', '%', doc='of its logarithm, of those that are ESTIMATED'),
    Column('sigma', '1-sigma', '%', digits=2, doc='Cramér-Rao, root mean square'),
    Column('back', 'back', doc='within 20 %, or 3 sigma where the sigma is above 7 %'),
    Column('verdicts', 'verdicts'),
)
_HELD_OUT = (
    Column('group', 'stated wrong'),
    Column('better', 'better', doc='predicted better than with what was stated'),
    Column('worse', 'worse'),
    Column('gain', 'gain', doc='of ln likelihood per number, mean'),
    Column('nis', 'NIS', doc='mean over sensors and seeds'),
    Column('inside', 'in band', doc='99.9 % band, of sensors and seeds'),
    Column('mems', 'said MEMS'),
    Column('well', 'settled'),
)
_INSTEAD = (
    Column('group', 'wrong'),
    Column('not_well', 'status 1'),
    Column('instead', 'something else than noise'),
    Column('suggested', 'noises suggested', doc='all seeds together'),
    Column('words', 'as if, of the first seed that said so'),
)
_AS_IF = re.compile(r'the recording is as if (.*?) \(ln likelihood')


def tables(results: Sequence[RunResult], size: Size, request: Request) -> list[Table]:
    """Tables of noises that were stated wrong, of parts held out, and of what else was wrong."""
    first = request.first_seed
    what = f'{size.duration_s:g} s, seeds {first} to {first + size.seeds - 1}'
    noises, judged, others = [], [], []
    for group in dict.fromkeys(r.group for r in results):
        runs = [r for r in results if r.group == group]
        row = next(r for r in ROWS if r.name == group)
        if row.fault is not None:
            others.append({'group': group, **_other(runs)})
            continue
        noises += [{'group': group, **line} for line in _lines(row, runs)]
        judged.append({'group': group, **_part(runs)})
    made = [
        Table(f'Noise found, {what}', _NOISES, tuple(noises)),
        Table(f'Held out, {what}', _HELD_OUT, tuple(judged)),
        Table(f'Something else than noise, {what}', _INSTEAD, tuple(others)),
    ]
    return [table for table in made if table.rows]


def _lines(row: Row, runs: Sequence[RunResult]) -> list[dict[str, object]]:
    """Lines of the noises that were stated wrong; of all where none was."""
    known = [k.removesuffix('.ratio') for k in runs[0].metrics if k.endswith('.ratio')]
    out = []
    for name in [n for n in known if n in row.factors or not row.factors]:
        seen = [r for r in runs if f'{name}.ratio' in r.metrics]
        verdicts = [_VERDICTS[int(r.metrics[f'{name}.verdict'])] for r in seen]
        sure = [r for r, v in zip(seen, verdicts, strict=True) if v is Verdict.ESTIMATED]
        line: dict[str, object] = {
            'name': name,
            'factor': row.factors.get(name, 1.0),
            'verdicts': ', '.join(f'{k} {v}' for v, k in Counter(verdicts).items()),
        }
        if sure:
            ratio = np.array([r.metrics[f'{name}.ratio'] for r in sure])
            sigma = np.array([r.metrics[f'{name}.sigma'] for r in sure])
            back = sum(map(is_back, ratio.tolist(), sigma.tolist()))
            line |= {
                'ratio': float(np.exp(np.mean(np.log(ratio)))),
                'rms': 100.0 * float(np.sqrt(np.mean(np.log(ratio) ** 2))),
                'sigma': 100.0 * float(np.sqrt(np.mean(sigma**2))),
                'back': f'{back} of {len(sure)}',
            }
        out.append(line)
    return out


def _part(runs: Sequence[RunResult]) -> dict[str, object]:
    def count(key: str) -> str:
        return f'{sum(r.metrics[key] for r in runs):.0f} of {len(runs)}'

    nis = [k for k in runs[0].metrics if k.startswith('nis.') and not k.endswith('.inside')]
    inside = [r.metrics[f'{k}.inside'] for r in runs for k in nis]
    return {
        'better': count('held_out.better'),
        'worse': count('held_out.worse'),
        'gain': float(np.mean([r.metrics['held_out.gain'] for r in runs])),
        'nis': float(np.mean([r.metrics[k] for r in runs for k in nis])),
        'inside': f'{sum(inside):.0f} of {len(inside)}',
        'mems': count('class.mems'),
        'well': f'{sum(not r.reason for r in runs)} of {len(runs)}',
    }


def _other(runs: Sequence[RunResult]) -> dict[str, object]:
    said = [found[1] for found in (_AS_IF.search(r.reason) for r in runs) if found]
    return {
        'not_well': f'{sum(bool(r.reason) for r in runs)} of {len(runs)}',
        'instead': f'{sum(r.metrics["instead"] for r in runs):.0f} of {len(runs)}',
        'suggested': f'{sum(r.metrics["suggested"] for r in runs):.0f}',
        'words': said[0] if said else '',
    }


def _describe(jobs: Sequence[TuneJob]) -> dict[str, Any]:
    named = {job.row for job in jobs}
    return {
        'filters': {COLUMN: {'engine': {'configuration': 'default'}}},
        'groups': {
            row.name: {
                'factors': dict(row.factors),
                'imu_class': row.imu_class,
                'fault': repr(row.fault),
            }
            for row in ROWS
            if row.name in named
        },
    }


TUNE = Experiment(
    'tune',
    'Noise that is stated wrong, found by `./polar tune`: against the truth, and held out',
    Size(600.0, 20),
    Size(300.0, 2),
    (COLUMN,),
    plan,
    tables,
    suite=one_filter_suite('tune', run_job, _describe),
    selects=True,
)
