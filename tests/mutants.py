"""Mutation testing: does some fast test fail when one operator or number of a module is changed?

    python tests/mutants.py                            # all modules of MODULES, at SEED
    python tests/mutants.py engine.ledger --seed 7     # one module, another sample
    python tests/mutants.py engine.ledger --show       # the sample only; nothing is run

A mutant is killed when one of the tests named beside its module fails, or when they need ten
times the processor time. The mutated source stands in a scratch folder, and an import hook puts it
in the place of the module (``mutants_worker.py``): the checkout is never written to. Kernels run
as plain Python (NUMBA_DISABLE_JIT=1), the rest with compiled kernels. ``mutants.yaml`` has the
mutants that change nothing that could be seen, each with the reason; all others that survive ask
for a test.

Operators are those of cosmic-ray. Its runner changes files of the checkout in place and wants a
database, so only its operators are used. Changes after which the code stops by a TypeError (a
shift of floats) are left out: any test kills them. So are changes of annotations and decorators
of kernels, which do nothing here.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import os
import random
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]
CORE = ROOT / 'polar_nav_core'
SEED = 14
SAMPLE = 30
LEAST_KILLED = 0.9
RING = 'not slow and not live and not long'
MODULES = {
    'engine.ledger': ('ledger',),
    'engine.reorder': ('reorder_queue', 'reorder'),
    'engine.plausibility': ('plausibility',),
    'engine.integrity': ('integrity_monitor', 'integrity'),
    'engine.clocks': ('clock_rules', 'clocks'),
    'engine.followed': ('followed', 'integrity_monitor'),
    'link.packet': ('packet', 'station_packet'),
    'kernels.frames.grid': ('grid', 'strapdown'),
    'kernels.frames.strapdown': ('strapdown', 'ecef_mechanization'),
    'kernels.frames.navigation': ('strapdown', 'ecef_mechanization'),
    'kernels.sins.error_model': ('error_model', 'nav_columns', 'measurements'),
    'kernels.sins.update': ('filter_kernels', 'consider', 'model_block'),
    'kernels.sins.consider': ('consider',),
    'kernels.sins.reopen': ('gate_rules',),
    'kernels.sins.enlarged': ('gate_rules',),
    'kernels.sins.shock': ('shock',),
    'kernels.sins.signatures': ('evidence', 'gate_rules'),
    'kernels.evidence': ('evidence',),
    'kernels.watch': ('watch', 'shared_errors'),
    'kernels.imu_sequence': ('refusals',),
    'engine.health.led': ('led',),
    'engine.health.mounting': ('mounting',),
    'engine.health.slow': ('signatures', 'led'),
    'engine.health.watchdog': ('watchdog', 'shared_errors'),
    'spilled': ('spilled',),
    'engine.sins.leader_way': ('leader_way', 'leader_error'),
    'engine.health.drifted': ('drifted',),
}
"""Modules, and the tests that judge them, quickest first (``core/test/test_<name>.py``)."""

_ARITHMETIC = {'Add', 'Sub', 'Mul', 'Div', 'FloorDiv', 'Mod', 'Pow'}
_COMPARISONS = {'Eq', 'NotEq', 'Lt', 'LtE', 'Gt', 'GtE'}
SMALL = {'kernels.sins.enlarged': 15}
"""Modules that have fewer than SAMPLE places to change, and how many."""

_MARKS = ('kernel', 'routine', 'entry')
"""Decorators that give the function itself back in plain Python."""
_UNLIKE = ('VariableReplacer', 'VariableInserter')
"""Operators of cosmic-ray that want names from the user."""


@dataclass(frozen=True)
class Mutant:
    """A module with one change; the changed lines as they were and as they are."""

    source: str
    line: int
    was: str
    now: str

    def __str__(self) -> str:
        """Line and change."""
        return f'line {self.line}\n      was: {self.was}\n      now: {self.now}'


@dataclass
class Tally:
    """What became of the sample of one module."""

    module: str
    seed: int
    equivalent: int = 0
    killed: int = 0
    stopped: int = 0
    """Of those killed, the ones that ran too long."""
    survivors: list[Mutant] = field(default_factory=list)

    @property
    def sampled(self) -> int:
        """Number of mutants."""
        return self.equivalent + self.killed + len(self.survivors)

    @property
    def enough(self) -> bool:
        """Whether nine of ten of those that are not equivalent were killed."""
        return self.killed >= LEAST_KILLED * (self.sampled - self.equivalent)

    def __str__(self) -> str:
        """One line of a table, then the survivors."""
        row = (
            f'{self.module} (seed {self.seed}): {self.sampled} sampled, {self.equivalent} '
            f'equivalent, {self.killed} killed ({self.stopped} by time), '
            f'{len(self.survivors)} survived'
        )
        return '\n'.join([row, *(f'  survived: {m}' for m in self.survivors)])


@contextmanager
def operators_of_cosmic_ray(scratch: Path) -> Iterator[None]:
    """Make cosmic-ray importable, installed into the scratch folder."""
    folder = scratch / 'cosmic_ray'
    wanted = Path(__file__).with_name('mutants_requirements.txt')
    pip = (sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps', '--require-hashes')
    subprocess.run([*pip, '--target', folder, '-r', wanted], check=True)
    sys.path.append(str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def path_of(module: str) -> Path:
    """File of a module of the core."""
    return CORE / 'polar_nav_core' / f'{module.replace(".", "/")}.py'


def sample(module: str, seed: int, count: int = SAMPLE) -> list[Mutant]:
    """Return mutants at ``count`` random places of a module, one random change at each."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.operators.provider import OperatorProvider

    source = path_of(module).read_text(encoding='utf-8')
    provider = OperatorProvider()
    places: dict[tuple[int, int], list[tuple[str, int]]] = {}
    for name in sorted(provider):
        if name in _UNLIKE or not _is_of_one_kind(name):
            continue
        operator = provider[name]()
        positions = (p for n in ast_nodes(get_ast(source)) for p in operator.mutation_positions(n))
        for occurrence, (start, _) in enumerate(positions):
            places.setdefault(start, []).append((name, occurrence))
    rng = random.Random(f'{seed} {module}')
    order = sorted(places)
    rng.shuffle(order)
    before, found = _essence(source), []
    for place in order:
        name, occurrence = rng.choice(places[place])
        changed = mutate_code(source, provider[name](), occurrence)
        if changed is None or _essence(changed) == before:
            continue
        found.append(_mutant(source, changed))
        if len(found) == count:
            break
    return found


def _is_of_one_kind(name: str) -> bool:
    """Whether a change of operators is one that most values allow."""
    kind, _, change = name.partition('_')
    if kind == 'ReplaceUnaryOperator':
        return 'Invert' not in change
    old, _, new = change.partition('_')
    if kind == 'ReplaceBinaryOperator':
        return (old in _ARITHMETIC) == (new in _ARITHMETIC)
    if kind == 'ReplaceComparisonOperator':
        return (old in _COMPARISONS) == (new in _COMPARISONS)
    return True


def _essence(source: str) -> str | None:
    """Syntax tree without what has no effect here; None for what Python does not read."""
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return _essence('')
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.arguments):  # the star in a signature is no product
            node.args = [*node.posonlyargs, *node.args, *node.kwonlyargs]
            node.defaults = [*node.defaults, *(d for d in node.kw_defaults if d is not None)]
            node.posonlyargs, node.kwonlyargs, node.kw_defaults = [], [], []
        elif isinstance(node, ast.FunctionDef):
            node.returns = None
            node.decorator_list = [
                d for d in node.decorator_list if getattr(d, 'id', '') not in _MARKS
            ]
    return ast.dump(tree)


def _mutant(source: str, changed: str) -> Mutant:
    old, new = source.splitlines(), changed.splitlines()
    for tag, i, j, k, m in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if tag != 'equal':
            was, now = (' '.join(x.strip() for x in xs) for xs in (old[i:j], new[k:m]))
            return Mutant(changed, i + 1, was, now)
    raise AssertionError('a mutant without a change')


def equivalents(module: str) -> set[tuple[str, str]]:
    """Changes of a module that were judged to change nothing that could be seen."""
    judged = yaml.safe_load(Path(__file__).with_name('mutants.yaml').read_text(encoding='utf-8'))
    return {(one['was'], one['now']) for one in judged.get(module, ())}


@contextmanager
def worker(module: str) -> Iterator[subprocess.Popen[str]]:
    """Process that runs the tests of a module (``mutants_worker.py``)."""
    program = Path(__file__).with_name('mutants_worker.py')
    tests = [str(CORE / 'test' / f'test_{name}.py') for name in MODULES[module]]
    with subprocess.Popen(
        # Bytecode of one mutant must not serve the next.
        (sys.executable, '-B', program, f'polar_nav_core.{module}', RING, *tests),
        cwd=ROOT,
        env={**os.environ, 'NUMBA_DISABLE_JIT': '1' if module.startswith('kernels.') else '0'},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        yield process


def end_of(process: subprocess.Popen[str], file: Path, source: str) -> str:
    """Return ``killed``, ``stopped`` or ``survived``: how the tests end with this source."""
    assert process.stdin is not None
    assert process.stdout is not None
    file.write_text(source, encoding='utf-8')
    process.stdin.write(f'{file}\n')
    process.stdin.flush()
    end = process.stdout.readline().strip()
    if end not in ('killed', 'stopped', 'survived'):
        raise AssertionError(f'the tests did not run: {end}')
    return end


def judge(module: str, seed: int = SEED, count: int = SAMPLE) -> Tally:
    """Return what became of a sample of mutants of a module."""
    tally = Tally(module, seed)
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        with operators_of_cosmic_ray(scratch):
            mutants = sample(module, seed, count)
        known = equivalents(module)
        with worker(module) as process:
            file = scratch / 'mutant.py'
            whole = path_of(module).read_text(encoding='utf-8')
            if end_of(process, file, whole) != 'survived':
                raise AssertionError(f'{module}: its tests fail without a mutant')
            for mutant in mutants:
                if (mutant.was, mutant.now) in known:
                    tally.equivalent += 1
                    continue
                end = end_of(process, file, mutant.source)
                if end == 'survived':
                    tally.survivors.append(mutant)
                tally.killed += end != 'survived'
                tally.stopped += end == 'stopped'
    return tally


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what became of the samples; status 1 if too few mutants were killed."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('modules', nargs='*', metavar='MODULE', help=f'one of {list(MODULES)}')
    parser.add_argument('--seed', type=int, default=SEED)
    parser.add_argument('--count', type=int, default=SAMPLE)
    parser.add_argument('--show', action='store_true', help='print the sample only')
    chosen = parser.parse_args(arguments)
    enough = True
    for module in chosen.modules or MODULES:
        if chosen.show:
            with tempfile.TemporaryDirectory() as name, operators_of_cosmic_ray(Path(name)):
                sys.stdout.writelines(f'{m}\n' for m in sample(module, chosen.seed, chosen.count))
            continue
        tally = judge(module, chosen.seed, chosen.count)
        enough &= tally.enough
        sys.stdout.write(f'{tally}\n')
        sys.stdout.flush()
    return 0 if enough else 1


if __name__ == '__main__':
    sys.exit(main())
