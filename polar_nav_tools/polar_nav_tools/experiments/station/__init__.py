"""Experiments `has-*`: navigation without a DVL by a station's late fixes, beside its paper."""
