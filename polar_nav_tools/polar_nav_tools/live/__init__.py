"""Runs a graph as processes of its own and keeps what it recorded."""
