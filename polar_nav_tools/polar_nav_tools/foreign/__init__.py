"""Bags of other people: their topics, types, frames, mountings and units to what the engine takes.

`mapping` says in YAML what is what; `sources` opens MCAP, sqlite3 and ROS 1 bags; `adapters` read
one family of messages each into arrays in SI units; `checks` look at the arrays before anything is
integrated; `replay` runs the engine. `guess` proposes a mapping; `table` makes bags of CSV files.
"""
