"""Live runs: the nodes of a graph as processes, and the folder of the run."""
