"""Smoothed tracks of whole bags: each estimate by all that was measured, before and after."""
