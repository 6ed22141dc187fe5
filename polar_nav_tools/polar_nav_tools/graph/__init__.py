"""Graphs of missions: nodes, namespaces, parameters, topics."""
