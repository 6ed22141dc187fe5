"""Compiled motion of simulated vehicles; polar_nav_core.kernels.cache stores the machine code."""
