"""``python -m polar_nav_tools.cli``."""

import sys

from polar_nav_tools.cli import main
from polar_nav_tools.terminal.garbage_collection import end_without_collecting

if __name__ == '__main__':
    status = main()
    end_without_collecting()
    sys.exit(status)
