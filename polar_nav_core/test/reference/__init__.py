"""Readable forms of what the kernels compute, for tests to hold both together."""
