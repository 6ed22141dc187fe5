"""Compiled model of the vehicle: dynamics, slopes, surge along a track."""
