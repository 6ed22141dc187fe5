"""The core's helper world serves here too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / 'polar_nav_core' / 'test'))
