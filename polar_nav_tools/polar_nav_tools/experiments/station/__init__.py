"""Experiments `has-*`: navigation without a DVL from a station's late fixes, beside its paper."""
