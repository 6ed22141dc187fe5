"""Helper modules importable in any import mode; hypothesis repeatable and without a deadline."""

import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))

# A first call may compile a kernel for seconds; the same examples each time, and no database in
# the tree.
settings.register_profile('core', deadline=None, derandomize=True, database=None)
settings.load_profile('core')
