"""Bags: writing without loss, reading what is there, repairing what is broken.

`writer` and `schemas` make rosbag2 MCAP bags out of serialized messages; `scan` and `reader` open
finished, unfinished and damaged ones and say what is missing; `cdr` and `arrays` turn messages
into NumPy arrays; `recover` and `info` stand behind the commands of the same names. Nothing here
starts a node; rclpy is imported only to decode single messages, where it is installed.
"""

from .errors import BagError
from .opening import open_bag
from .reader import Bag
from .writer import BagWriter

__all__ = ['Bag', 'BagError', 'BagWriter', 'open_bag']
