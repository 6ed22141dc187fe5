"""Test suite, environment and generated pages of this repository."""
