"""The navigation engine of a vehicle: stamped events in, estimates and receipts out; no ROS."""
