"""Names of culprits, the same in the rows, in the reports and in the judge."""

from __future__ import annotations

FIXES, DVL, DEPTH, IMU = 'fixes', 'DVL', 'depth', 'IMU'
HEADING, MODEL, UNEXPLAINED = 'heading', 'model', 'unexplained'
