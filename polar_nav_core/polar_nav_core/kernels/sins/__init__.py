"""Compiled filter of the strapdown mode: error model, covariance steps, updates, whole runs."""
