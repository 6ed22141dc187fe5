"""Navigation mathematics at home at the pole: imports numpy, scipy, numba, gsw and nothing of ROS."""
