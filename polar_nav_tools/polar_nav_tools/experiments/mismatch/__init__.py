"""Mismatch of world and filter model: faults, runs, judgement, one table."""
