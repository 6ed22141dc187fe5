"""The `polar` command line tool.

Every command loads what it needs when it runs, so that ``polar --help`` is there at once. Figures
go to stdout (as pure JSON with ``--json``), everything else to stderr; the exit status is 0 only
when all is well.
"""

from .app import app, main

__all__ = ['app', 'main']
