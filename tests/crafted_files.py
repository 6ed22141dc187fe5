"""How long crafted files take, and how much memory: asked for are 10 s and 1 GB for each answer.

    python tests/crafted_files.py                 # every file with every command
    python tests/crafted_files.py zeros channels  # some of them

Each answer is a process of its own. Its time is that of the processor, which other work of the
machine does not change, with that of starting the program.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / 'polar_nav_tools' / 'test'))

from crafted import TEXT, crafted

MOST_S, MOST_MB = 10.0, 1000.0
BAG_COMMANDS = ('info', 'doctor', 'score', 'verify', 'replay', 'map', 'recover')
_DATA = b'\0\1\0\0abcd'


def zeros(path: Path) -> Path:
    """A few hundred kilobytes that decompress to 1.5 GB."""
    return crafted(path, ((0, k, bytes(15_000_000)) for k in range(100)))


def channels(path: Path) -> Path:
    """60,000 channels with a message each."""
    return crafted(path, ((k, k, _DATA) for k in range(60_000)), 60_000)


def definition(path: Path) -> Path:
    """A definition of 100,000 lines."""
    return crafted(path, iter([(0, 0, _DATA)]), text='uint8 A=1\n' * 100_000 + TEXT)


def nested(path: Path) -> Path:
    """A definition of types that nest 2,000 deep."""
    line = '=' * 80
    parts = [f'{line}\nMSG: p/T{k}\np/T{k + 1} a\n' for k in range(2000)]
    end = f'{line}\nMSG: p/T2000\n{TEXT}'
    return crafted(path, iter([(0, 0, _DATA)]), text=f'p/T0 a\n{"".join(parts)}{end}')


def times(path: Path) -> Path:
    """Log times beyond 2^63, and the same stamp a hundred thousand times."""
    messages = [(0, 1, _DATA)] * 100_000 + [(0, (1 << 64) - 1, _DATA)]
    return crafted(path, iter(messages))


def rubbish(path: Path) -> Path:
    """The beginning of an MCAP file, then 20 MB of nothing that it could be."""
    path.write_bytes(b'\x89MCAP0\r\n' + bytes(range(256)) * 80_000)
    return path


def pipe(path: Path) -> Path:
    """A pipe that nobody writes to."""
    os.mkfifo(path)
    return path


BAGS: dict[str, Callable[[Path], Path]] = {
    f.__name__: f for f in (zeros, channels, definition, nested, times, rubbish, pipe)
}
_ALIASES = 'a0: &a0 [x, x, x, x, x, x, x, x, x]\n' + ''.join(
    f'a{k}: &a{k} [{", ".join([f"*a{k - 1}"] * 9)}]\n' for k in range(1, 12)
)
TEXTS = {
    'aliases': _ALIASES,
    'brackets': '[' * 100_000,
    'digits': f'duration_s: {"9" * 5001}\n',
    'long': 'description: ' + 'x' * 30_000_000,
}
"""YAML, as a mission and as a mapping."""


def measured(arguments: Sequence[str]) -> tuple[float, float, int, str]:
    """Processor time [s], largest memory [MB], status and last line of a call of ./polar."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    program = (
        'import resource, runpy, sys; sys.argv[0] = "polar"\n'
        'try:\n    runpy.run_module("polar_nav_tools.cli", run_name="__main__")\n'
        'finally:\n    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)'
    )
    done = subprocess.run(
        (sys.executable, '-P', '-c', program, *arguments),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors='replace',
        timeout=600.0,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    *said, memory = done.stderr.splitlines() or ['0']
    lines = [*done.stdout.splitlines(), *said]
    traceback = 'Traceback' in done.stderr
    last = 'TRACEBACK' if traceback else next((x for x in reversed(lines) if x.strip()), '')
    return used_s, int(memory) / 1000.0 if memory.isdigit() else 0.0, done.returncode, last


def calls(folder: Path, chosen: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Name and arguments of each call."""
    for name, make in BAGS.items():
        if name in chosen:
            path = make(folder / f'{name}.mcap')
            for command in BAG_COMMANDS:
                yield f'{name}: {command}', [command, str(path)]
    for name, text in TEXTS.items():
        if name in chosen:
            path = folder / f'{name}.yaml'
            path.write_text(text, encoding='utf-8')
            yield f'{name}: demo --mission', ['demo', '--mission', str(path)]
            bag = str(Path(__file__).resolve().parents[1] / 'bags' / 'reference')
            yield f'{name}: replay --map', ['replay', bag, '--map', str(path)]


def main(arguments: Sequence[str]) -> int:
    """Print a line for each answer; status 1 if one is over a limit, or a traceback."""
    over = 0
    with tempfile.TemporaryDirectory() as name:
        for title, call in calls(Path(name), arguments or [*BAGS, *TEXTS]):
            used_s, memory_mb, status, last = measured(call)
            bad = used_s > MOST_S or memory_mb > MOST_MB or last == 'TRACEBACK'
            over += bad
            mark = '  OVER' if bad else ''
            used = f'{used_s:.1f} s, {memory_mb:.0f} MB, status {status}{mark}'
            sys.stdout.write(f'{title}: {used}: {last[:90]}\n')
            sys.stdout.flush()
    return 1 if over else 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
