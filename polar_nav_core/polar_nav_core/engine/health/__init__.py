"""Watchdog: conditions of a navigation by innovations, refusals and silences of its sensors."""
