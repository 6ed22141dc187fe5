"""Faults of sensors, clocks and packets, injected into bags and into runs of the engine."""
