"""Exit status of every command: the one rule (docs/trust.md).

| status | when |
| --- | --- |
| 0 | well; also when the reader of the output went away (``| head``) |
| 1 | not well: a bag, a run or a comparison is not as it should be, or the work failed |
| 2 | wrong call: an option, a name or a file that was named cannot be used |

There is no other, but for a command that a signal ended: 128 and its number, as shells have it
(130 for Ctrl-C). Whether a run is well is judged by `engine.health.span` of what ran live and of
`default`, or of the one configuration that was named; others beside it are for comparison.
"""

from __future__ import annotations

import signal

from polar_nav_core.errors import ConfigError

WELL, NOT_WELL, WRONG_CALL = 0, 1, 2

_WRONG_CALLS = (
    ConfigError,
    FileNotFoundError,
    FileExistsError,
    IsADirectoryError,
    NotADirectoryError,
)


def of_signal(number: int) -> int:
    """Exit status of a command that a signal ended."""
    return 128 + number


def of_error(error: BaseException) -> int:
    """Exit status of a command that ended with an error."""
    if isinstance(error, BrokenPipeError):
        return WELL
    if isinstance(error, KeyboardInterrupt):
        return of_signal(signal.SIGINT)
    return WRONG_CALL if isinstance(error, _WRONG_CALLS) else NOT_WELL
