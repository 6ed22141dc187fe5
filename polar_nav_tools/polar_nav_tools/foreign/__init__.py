"""Bags of other systems: topics, types, frames, mountings and units converted for the engine.

`mapping` describes a bag in YAML; `sources` opens MCAP, sqlite3 and ROS 1 bags; `adapters` read
one family of messages each into arrays in SI units; `checks` look at the arrays before anything is
integrated; `replay` runs the engine. `guess` proposes a mapping; `table` makes bags of CSV files.
"""
