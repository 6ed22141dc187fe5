"""Conversion of received packets to position fixes."""
