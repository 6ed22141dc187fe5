"""Bags of any origin published live again: recorded QoS, types of the bag, pace, /clock.

`selection`, `offers`, `order`, `pace` and `schemas` are pure; `generate` builds message packages
that are not installed, `tracks` and `player` make publishers, `run` plays.
"""
