"""Geometry of missions: from what a mission file says to knots of position and attitude."""
