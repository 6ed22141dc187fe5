"""Every bag that a test opens is also read by mcap's own reader, and the two must agree."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from against_mcap import bags_also_read_by_mcap  # noqa: F401 - a fixture of every test
from loopback_storage import s3, web  # noqa: F401 - fixtures of those that name them
