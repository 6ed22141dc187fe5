"""Navigation mathematics at home at the pole: numpy, scipy, numba, gsw and nothing of ROS."""
