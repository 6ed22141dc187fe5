"""Experiment `calibrate`: constants that are off, and what is found of them."""
