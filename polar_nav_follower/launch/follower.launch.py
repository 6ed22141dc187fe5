"""Launch description of a follower: `ros2 launch polar_nav_follower follower.launch.py`.

Navigates with the topics of this project, or, with `sources`, with the vehicle's own drivers
(docs/operation.md).
"""

from launch import LaunchDescription

from polar_nav_ros.launching import vehicle_launch


def generate_launch_description() -> LaunchDescription:
    """Launch description: arguments, then the node that follows from them."""
    return vehicle_launch(
        'polar_nav_follower',
        'follower_node',
        'follower',
        {
            'sources': 'Mapping file of sensors and fixes; empty: as the parameters state',
            'state_file': 'File from which it goes on after a restart; empty: as they state',
        },
    )
