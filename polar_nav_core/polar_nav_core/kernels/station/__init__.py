"""Compiled filter of the station mode: state, steps, fixes, whole runs."""
