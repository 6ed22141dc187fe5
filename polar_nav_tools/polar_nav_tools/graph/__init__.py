"""The graphs that can be run: nodes, namespaces, parameters, topics."""
