"""Compiled reading of MCAP blocks; polar_nav_core.kernels.cache stores the machine code."""
