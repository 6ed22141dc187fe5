"""Verdicts on runs with injected faults of messages: recovered, reported, silent or dead."""
