"""Adapters: foreign messages of any origin to canonical quantities, live and offline."""
