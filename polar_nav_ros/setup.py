"""Build of polar_nav_ros as an ament_python package."""

from setuptools import find_packages, setup

NAME = 'polar_nav_ros'

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
        'What all polar_nav nodes share: parameters, drained subscriptions, lockstep '
        'acknowledgements, diagnostics.'
    ),
    license='Apache-2.0',
    python_requires='>=3.11',
    install_requires=['setuptools'],
    extras_require={'test': ['pytest', 'pytest-timeout']},
)
