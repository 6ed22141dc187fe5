"""Benchmarks beside peers: the same work, the same run, results compared before times are quoted."""
