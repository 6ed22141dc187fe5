"""Geometry of missions: knots of position and attitude by the path of a mission file."""
