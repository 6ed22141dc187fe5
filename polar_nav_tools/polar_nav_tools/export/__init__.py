"""Trajectories of a bag as files for other tools: TUM and CSV."""
