"""Examination of a bag: missing parts, gaps and rates, consistency of its times."""
