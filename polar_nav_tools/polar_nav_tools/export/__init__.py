"""Trajectories of a bag as files for other people's tools."""
