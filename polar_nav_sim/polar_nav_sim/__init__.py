"""Simulation: exact truth, sensor error models, the acoustic channel, and a node for each."""
