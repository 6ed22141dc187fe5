"""Launch description of a leader: `ros2 launch polar_nav_leader leader.launch.py`."""

from launch import LaunchDescription

from polar_nav_ros.launching import vehicle_launch


def generate_launch_description() -> LaunchDescription:
    """Launch description: arguments, then the node that follows from them."""
    return vehicle_launch(
        'polar_nav_leader',
        'leader_node',
        'leader',
        {'sources': 'Mapping file of its own sensors (navigation: own); empty: as they state'},
    )
