"""``python -m polar_nav_tools.cli``."""

import sys

from polar_nav_tools.cli import main

sys.exit(main())
