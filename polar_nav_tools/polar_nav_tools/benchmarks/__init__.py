"""Benchmarks beside peers: same work, same run, results compared before times are quoted."""
