"""Benchmarks beside other libraries: same work, same run, results compared before times."""
