"""Build of polar_nav_tools as an ament_python package."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = 'polar_nav_tools'


def shared(folder: str) -> list[tuple[str, list[str]]]:
    """List the data files of one folder; share/ repeats the layout of the sources."""
    files = [p for p in Path(folder).rglob('*') if p.is_file() and p.suffix != '.pyc']
    parents = sorted({p.parent for p in files})
    return [(f'share/{NAME}/{d}', sorted(str(p) for p in files if p.parent == d)) for d in parents]


setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={NAME: ['py.typed', 'report/templates/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *shared('config'),
        *shared('launch'),
        *shared('layouts'),
    ],
    zip_safe=False,
    author='The polar_nav founders',
    maintainer='The polar_nav founders',
    maintainer_email='polar-nav@users.noreply.github.com',
    description=(
        'Recorder, bag reading, replay, scoring, report, launch and the command line of polar_nav.'
    ),
    license='Apache-2.0',
    python_requires='>=3.11',
    install_requires=['setuptools'],
    extras_require={'test': ['pytest', 'pytest-timeout']},
    entry_points={
        'console_scripts': [
            'recorder_node = polar_nav_tools.record.recorder_node:main',
            'polar = polar_nav_tools.cli:main',
        ],
    },
)
