"""Build of polar_nav_sim as an ament_python package."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = 'polar_nav_sim'


def shared(folder: str) -> list[tuple[str, list[str]]]:
    """List the data files of one folder; share/ repeats the layout of the sources."""
    files = [p for p in Path(folder).rglob('*') if p.is_file() and p.suffix != '.pyc']
    parents = sorted({p.parent for p in files})
    return [(f'share/{NAME}/{d}', sorted(str(p) for p in files if p.parent == d)) for d in parents]


setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={NAME: ['py.typed', 'data/**']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *shared('config'),
        *shared('missions'),
    ],
    zip_safe=False,
    author='The polar_nav founders',
    maintainer='The polar_nav founders',
    maintainer_email='polar-nav@users.noreply.github.com',
    description=(
        'Simulation for polar_nav: truth, sensor models and the acoustic link, each with its node.'
    ),
    license='Apache-2.0',
    python_requires='>=3.11',
    install_requires=['setuptools'],
    extras_require={'test': ['avar', 'gsw', 'matplotlib', 'pytest', 'pytest-timeout']},
    entry_points={
        'console_scripts': [
            'vehicle_node = polar_nav_sim.nodes.vehicle_node:main',
            'station_node = polar_nav_sim.nodes.station_node:main',
            'truth_node = polar_nav_sim.nodes.truth_node:main',
            'imu_node = polar_nav_sim.nodes.imu_node:main',
            'dvl_node = polar_nav_sim.nodes.dvl_node:main',
            'depth_node = polar_nav_sim.nodes.depth_node:main',
            'usbl_node = polar_nav_sim.nodes.usbl_node:main',
            'absolute_fix_node = polar_nav_sim.nodes.absolute_fix_node:main',
            'leader_reference_node = polar_nav_sim.nodes.leader_reference_node:main',
            'acoustic_link_node = polar_nav_sim.nodes.acoustic_link_node:main',
        ],
    },
)
