"""How much a bag may ask for beside its size; `./polar --no-limits` reads any bag.

A bag is read in a time proportional to its bytes. Compression could ask for a thousand times more:
80 million empty messages fit into 370 kB, and nobody waits for them on purpose. Recorded sensors
compress two to ten times, constant ones up to some forty.
"""

from __future__ import annotations

from .errors import BagError

_FREE_BYTES = 64 * 1024 * 1024
_MOST_RATIO = 50
_MOST_LINES = 5000
"""Of a message definition; those of ROS packages have up to a few hundred."""
LIFT = '`./polar --no-limits` before the command reads it all the same'

_state = {'limited': True}


def lift() -> None:
    """Read whatever a bag asks for, for the rest of the process."""
    _state['limited'] = False


def check_size(name: str, stored: int, uncompressed: int) -> None:
    """Refuse a file of `stored` bytes when its chunks have more than so many bytes together.

    Raises
    ------
    BagError
        Naming the file, both numbers, and how it is read all the same.
    """
    if _state['limited'] and uncompressed > _FREE_BYTES + _MOST_RATIO * stored:
        raise BagError(
            f'{name}: its {stored * 1e-6:.1f} MB decompress to more than '
            f'{uncompressed * 1e-6:.0f} MB, as no recording does; {LIFT}'
        )


def check_definition(text: str, type_name: str) -> None:
    """Refuse a message definition whose parser would take minutes.

    Raises
    ------
    BagError
        Naming the type.
    """
    if not _state['limited'] or text.count('\n') <= _MOST_LINES:
        return
    lines = sum(1 for line in text.splitlines() if line.strip() and not line.startswith('#'))
    if lines > _MOST_LINES:
        raise BagError(f'the definition of {type_name} has {lines} lines; {LIFT}')
