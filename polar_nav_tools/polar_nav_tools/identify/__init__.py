"""Identification of drag and current from a recorded bag."""
