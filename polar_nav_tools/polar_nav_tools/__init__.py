"""Recorder, bag reading, replay, scoring, report, launch and the command line."""
