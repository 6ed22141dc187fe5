"""ROS nodes of the simulation: thin, each around one model of this package."""
