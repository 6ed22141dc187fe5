"""Experiments of both papers, offline: simulated worlds as arrays, filters compared."""
