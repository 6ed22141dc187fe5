"""Many tasks: on one core, a cluster of this machine or any Dask scheduler; rows that last."""
