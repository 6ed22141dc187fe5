"""Build of polar_nav_leader as an ament_python package, all of it declared in setup.cfg."""

from setuptools import setup

setup()
