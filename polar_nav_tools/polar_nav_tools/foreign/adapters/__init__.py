"""Adapters: one family of foreign messages each, to arrays in SI units and the body's axes."""
