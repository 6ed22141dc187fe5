"""Vehicles that move by their own dynamics: what a mission says of them, motion, truth."""
