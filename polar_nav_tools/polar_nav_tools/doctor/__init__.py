"""Examines a bag: what is missing, how regular it is, whether its times add up."""
