"""Build of polar_nav_core as an ament_python package."""

from setuptools import find_packages, setup

NAME = 'polar_nav_core'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={NAME: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    zip_safe=False,
    author='The polar_nav founders',
    maintainer='The polar_nav founders',
    maintainer_email='polar-nav@users.noreply.github.com',
    description=(
        'Navigation mathematics of polar_nav: frames, grid mechanisation, error-state '
        'filter, compiled kernels. No ROS.'
    ),
    license='Apache-2.0',
    python_requires='>=3.11',
    install_requires=['setuptools'],
    extras_require={'test': ['pytest', 'pytest-timeout']},
)
