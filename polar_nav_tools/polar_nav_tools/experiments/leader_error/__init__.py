"""Fixes of a leader that is off itself: whether the follower knows how far it is off."""
