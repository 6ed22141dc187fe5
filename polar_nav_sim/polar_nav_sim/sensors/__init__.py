"""Sensor error models: truth goes in, what an instrument would say comes out."""
