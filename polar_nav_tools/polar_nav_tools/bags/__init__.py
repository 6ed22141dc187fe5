"""MCAP bags: written without loss, read whole or damaged, repaired.

`writer` and `schemas` make rosbag2 MCAP bags out of serialized messages; `scan`, `opening` and
`reader` open finished, unfinished and damaged ones and list missing parts; `arrays` and `tables`
turn messages into NumPy arrays, `ahead` does it in the same pass; `recover` and `info` stand
behind the commands of the same names. Nothing here starts a node; rclpy is imported only to decode
single messages, where it is installed.
"""

from .errors import BagError
from .opening import open_bag
from .reader import Bag
from .writer import BagWriter

__all__ = ['Bag', 'BagError', 'BagWriter', 'open_bag']
