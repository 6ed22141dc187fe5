"""Campaigns: many runs over seeds and parameters, as a file states them; rows and a report."""
