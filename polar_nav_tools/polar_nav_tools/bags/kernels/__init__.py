"""Compiled reading of MCAP blocks (polar_nav_core.kernels.cache says where it is kept)."""
