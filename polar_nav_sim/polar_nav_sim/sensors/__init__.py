"""Sensor error models: readings of an instrument from the truth."""
