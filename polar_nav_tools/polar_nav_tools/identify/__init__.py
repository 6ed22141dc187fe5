"""Drag and current from a recorded bag."""
