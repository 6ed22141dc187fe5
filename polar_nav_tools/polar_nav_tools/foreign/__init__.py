"""Bags of other systems: topics, types, frames, mountings and units converted for the engine.

A mapping file describes a bag; `sources` opens MCAP, sqlite3 and ROS 1 bags; `read` gives topics
to the adapters (`polar_nav_ros.adapters`, which a running vehicle uses, too), which make arrays in
SI units of them; `check_*` look at the arrays before anything is integrated; `replay` runs the
engine. `guess` proposes a mapping; `table` makes bags of CSV files.
"""
