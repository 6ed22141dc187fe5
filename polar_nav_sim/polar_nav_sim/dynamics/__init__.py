"""Vehicles that move by their own dynamics: specification, motion, truth."""
