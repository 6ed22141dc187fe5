"""Links of this tree's packages into a virtual environment, and the lock file.

`./polar` runs this file by its path, before anything of ours can be imported: it uses the standard
library and setuptools only.

``link``: the environment gets a .pth file with the package roots, the programs of each setup.cfg
under lib/<package> (where ``ros2 run`` looks for them), the marker of the ament index, and
share/<package> as a link to the sources. Nothing is copied: an edited module, launch file or
parameter file takes effect at once.

``install``: install by uv what its arguments name, from where and how pip's own settings say.

``lock``: resolve requirements.in with the running Python and write name==version of all it brings,
with the sha256 of the files that Python 3.11 and 3.12 take.
Not ``pip freeze``: the ROS wheels leave metadata of names that pip did not install.
"""

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = tuple(
    f'polar_nav_{part}' for part in ('core', 'ros', 'sim', 'leader', 'follower', 'tools')
)
PYTHONS = ('3.11', '3.12')
# The only requirement without a wheel; it is pure Python.
SDISTS = ('empy',)

UV_OPTIONS = (
    '--no-deps', '--require-hashes', '--only-binary', ':all:', '--no-binary', *SDISTS,
    '--no-build-isolation', '--system-certs',
    # As pip: the best file of all places. Which that is, the hashes decide.
    '--index-strategy', 'unsafe-best-match',
)  # fmt: skip
PIP_SECTIONS = ('global', 'install', ':env:')
PIP_PLACES = {
    'index-url': '--default-index',
    'extra-index-url': '--index',
    'find-links': '--find-links',
    'trusted-host': '--allow-insecure-host',
}
PIP_SWITCHES = {'no-index': '--no-index', 'no-cache-dir': '--no-cache'}
PIP_VARIABLES = {
    'client-cert': ('SSL_CLIENT_CERT',),
    'proxy': ('HTTP_PROXY', 'HTTPS_PROXY', 'ALL_PROXY'),
    'default-timeout': ('UV_HTTP_TIMEOUT',),
    'timeout': ('UV_HTTP_TIMEOUT',),
    'retries': ('UV_HTTP_RETRIES',),
}
"""Settings of pip, and what uv calls them."""

LOCK_HEADER = (
    '# Written by `./polar lock` from requirements.in; the same pins serve Python 3.11 and 3.12.\n'
    '# Each hash is of a file that one of them takes: pip --require-hashes refuses any other.'
)

PROGRAM = """\
{shebang}
import os
import signal
import sys

# Ctrl-C before the program can handle it ends it at once, without a traceback.
before = signal.signal(signal.SIGINT, signal.SIG_DFL)
from {module} import {function}

signal.signal(signal.SIGINT, before)
status = {function}()
sys.stdout.flush()
sys.stderr.flush()
# It has ended in order; taking the interpreter apart costs a node 0.4 s, and there are a dozen.
os._exit(status or 0)
"""
LONGEST_SHEBANG = 127

METADATA = """\
Metadata-Version: 2.1
Name: {name}
Version: {version}
"""


@dataclass(frozen=True)
class Package:
    """Declarations in the setup.cfg of one package."""

    name: str
    version: str
    programs: dict[str, str]
    """Console scripts, name to ``module:function``."""


def declared(folder: Path) -> Package:
    """Declarations of the package in ``folder``, read from its setup.cfg without a build."""
    importlib.import_module('setuptools')  # provides distutils where Python no longer does
    from distutils.core import run_setup

    before = Path.cwd()
    os.chdir(folder)
    try:
        found = run_setup('setup.py', stop_after='config')
    finally:
        os.chdir(before)
    entry_points: dict[str, list[str]] = getattr(found, 'entry_points', None) or {}
    scripts = (line.split('=') for line in entry_points.get('console_scripts', []))
    programs = {name.strip(): target.strip() for name, target in scripts}
    return Package(found.get_name(), found.get_version(), programs)


def link(prefix: Path) -> None:
    """Link the packages of the tree into the environment at ``prefix``; again is harmless."""
    site = Path(sysconfig.get_path('purelib', vars={'base': str(prefix)}))
    index = prefix / 'share/ament_index/resource_index/packages'
    index.mkdir(parents=True, exist_ok=True)
    for name in PACKAGES:
        package = declared(ROOT / name)
        (index / name).touch()
        share = prefix / 'share' / name
        share.unlink(missing_ok=True)
        share.symlink_to(os.path.relpath(ROOT / name, share.parent))
        write_programs(prefix / 'lib' / name, package.programs)
        for old in site.glob(f'{name}-*.dist-info'):
            shutil.rmtree(old)
        info = site / f'{name}-{package.version}.dist-info'
        info.mkdir()
        (info / 'METADATA').write_text(METADATA.format(name=name, version=package.version))
        (info / 'INSTALLER').write_text('polar\n')
        sys.stdout.write(f'linked {name}\n')
    (site / 'polar_nav.pth').write_text(''.join(f'{ROOT / name}\n' for name in PACKAGES))


def write_programs(folder: Path, programs: dict[str, str]) -> None:
    """Write exactly these programs to ``folder``."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    shebang = shebang_of(sys.executable)
    for program, target in programs.items():
        module, function = target.split(':')
        file = folder / program
        file.write_text(PROGRAM.format(shebang=shebang, module=module, function=function))
        file.chmod(0o755)


def shebang_of(python: str) -> str:
    """First line of a program; two if the kernel cannot use the path of Python.

    The shell reads an empty text and ``exec``; Python, started by it, a text in triple quotes.
    """
    line = f'#!{python}'
    if ' ' not in line and len(line) <= LONGEST_SHEBANG:
        return line
    return f"""#!/bin/sh
'''exec' "{python}" "$0" "$@"
' '''"""


def install(arguments: Sequence[str]) -> NoReturn:
    """Become uv, which installs into this environment with the settings that pip has here."""
    pip = [sys.executable, '-m', 'pip', 'config', 'list']
    listed = subprocess.run(pip, check=True, stdout=subprocess.PIPE, text=True).stdout
    options, variables = as_uv_takes_it(pip_settings(listed))
    uv = str(Path(sys.executable).parent / 'uv')
    command = [uv, 'pip', 'install', '--python', sys.executable, *UV_OPTIONS, *options]
    if '--no-cache' not in options and not _writable(_uv_cache()):
        command.append('--no-cache')
    os.execve(uv, [*command, *arguments], {**os.environ, **variables})


def _uv_cache() -> Path:
    """Folder where uv keeps what it has fetched."""
    own = os.environ.get('UV_CACHE_DIR')
    xdg = os.environ.get('XDG_CACHE_HOME')
    home = Path(os.environ.get('HOME') or '/')
    return Path(own) if own else (Path(xdg) if xdg else home / '.cache') / 'uv'


def _writable(folder: Path) -> bool:
    """Whether this folder, or the nearest one above it that exists, can be written."""
    nearest = next(f for f in (folder, *folder.absolute().parents) if f.exists())
    return os.access(nearest, os.W_OK)


def pip_settings(listed: str) -> dict[str, str]:
    """Settings of ``pip install`` by name, from what ``pip config list`` prints.

    Sections in the order in which pip reads them: those of a command override those of all, and
    environment variables override both.
    """
    found: dict[str, dict[str, str]] = {section: {} for section in PIP_SECTIONS}
    for line in listed.splitlines():
        name, _, value = line.partition('=')
        section, _, key = name.rpartition('.')
        if section in found:
            found[section][key] = str(ast.literal_eval(value))
    return {key: value for section in found.values() for key, value in section.items()}


def as_uv_takes_it(settings: Mapping[str, str]) -> tuple[list[str], dict[str, str]]:
    """Options and environment variables for uv that say what these settings say to pip."""
    options = [
        text
        for name, option in PIP_PLACES.items()
        for value in settings.get(name, '').split()
        for text in (option, value)
    ]
    for name, option in PIP_SWITCHES.items():
        if settings.get(name, '').lower() in ('1', 'true', 'yes', 'on', 'y', 't'):
            options.append(option)
    if 'cert' in settings:
        options += ['--cert', settings['cert']]
    variables = {
        variable: settings[name]
        for name, names in PIP_VARIABLES.items()
        if name in settings
        for variable in names
    }
    return options, variables


def lock() -> None:
    """Write requirements.lock: pins that exist for all supported Pythons, with their hashes."""
    pins = sorted(_reported('-r', str(ROOT / 'requirements.in')))
    wheels = [pin for pin in pins if not pin.startswith(SDISTS)]
    found = [_reported('--no-deps', *(pin for pin in pins if pin not in wheels))]
    for version in PYTHONS:
        with tempfile.TemporaryDirectory() as target:
            other = ('--only-binary', ':all:', '--target', target, '--python-version', version)
            found.append(_reported('--no-deps', *other, *wheels))
        sys.stderr.write(f'{len(wheels)} wheels exist for Python {version}\n')
    (ROOT / 'requirements.lock').write_text(lock_text(found))


def _reported(*arguments: str) -> dict[str, str]:
    """Pins that pip would install, with the sha256 of the file that it would take."""
    pip = [sys.executable, '-m', 'pip', 'install', '--quiet', '--dry-run', '--ignore-installed']
    run = subprocess.run(
        [*pip, '--report', '-', *arguments], check=True, stdout=subprocess.PIPE, text=True
    )
    return pins_of(json.loads(run.stdout))


def pins_of(report: Mapping[str, Any]) -> dict[str, str]:
    """Pins of a report of pip, each with the sha256 of its file."""
    found: dict[str, str] = {}
    for entry in report['install']:
        name = re.sub('[-_.]+', '-', entry['metadata']['name']).lower()
        pin = f'{name}=={entry["metadata"]["version"]}'
        found[pin] = entry['download_info']['archive_info']['hashes']['sha256']
    return found


def lock_text(found: Sequence[Mapping[str, str]]) -> str:
    """Text of a lock file: every pin of some reports with all hashes that they have for it."""
    hashes: dict[str, set[str]] = {}
    for pins in found:
        for pin, digest in pins.items():
            hashes.setdefault(pin, set()).add(digest)
    lines = [LOCK_HEADER]
    for pin in sorted(hashes):
        lines += [' \\\n    '.join([pin, *(f'--hash=sha256:{h}' for h in sorted(hashes[pin]))])]
    return '\n'.join(lines) + '\n'


if __name__ == '__main__':
    match sys.argv[1:]:
        case ['link']:
            link(Path(sys.prefix))
        case ['install', *arguments]:
            install(arguments)
        case ['lock']:
            lock()
        case _:
            sys.exit(f'usage: {sys.argv[0]} link|install|lock')
