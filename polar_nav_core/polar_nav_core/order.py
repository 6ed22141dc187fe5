"""Numbers that the engine and its compiled kernels have in common, each defined once.

Compiled code knows no enumerations, and a number that stands in two files can drift apart without
an error. Kernels read these as attributes of their ``state`` modules, where they are variables to
the compiler. `kernels.cache` hashes this file, so that a change here compiles all kernels again.
"""

from __future__ import annotations

# Order of the streams within one stamp (engine.events.Rank).
IMU_RANK = 0
CONTROL_RANK = 1
DEPTH_RANK = 2
DVL_RANK = 3
HEADING_RANK = 4
FIX_RANK = 5
COMMAND_RANK = 6

NEVER_NS = 9_223_372_036_854_775_807
"""Stamp that no event reaches [ns]."""

# What became of a measurement at the gate; a code below zero is no decision.
UNDECIDED = -1
REFUSED = 0
FUSED = 1

# Rows of a tally of measurements: one per source.
DVL_ROW = 0
DEPTH_ROW = 1
FIX_ROW = 2

# Columns of a tally: measurements used, refused by the gate, sum of the NIS of those used.
UPDATES = 0
GATED = 1
NIS_SUM = 2

ROBUST_FIXES = ('none', 'huber', 'mahalanobis')
"""Ways to give position fixes far off the estimate less weight; kernels know them by index."""
ROBUST_NONE, ROBUST_HUBER, ROBUST_MAHALANOBIS = 0, 1, 2
