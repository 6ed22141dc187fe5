"""Experiment `tune`: noise that is stated wrong, and what is found of it."""
