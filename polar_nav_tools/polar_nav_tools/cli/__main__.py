"""``python -m polar_nav_tools.cli``."""

import sys

from polar_nav_tools.cli import main

if __name__ == '__main__':
    sys.exit(main())
