"""Compiled model of the vehicle: slopes, surge along a track."""
