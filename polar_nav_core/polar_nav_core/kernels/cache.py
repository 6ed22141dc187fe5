"""Where compiled kernels are kept, and the decorators that compile them.

Numba notices a change of the file that holds a function, but not of a callee in another file: a
kernel compiled against yesterday's callee would be loaded and would silently return yesterday's
numbers. So compiled code stands in folders named ``kernels`` only (here, and with the bags in
polar_nav_tools), and each source file has a cache directory whose name carries a hash of that
file, of every file of the folder that it imports (and those import), of the numba version and of
the CPU: an edit of any of them, another numba or another processor means another directory, while
kernels that do not stand on the edited file stay compiled. Kernels of one folder do not call those
of another. Neither path nor time of a source file counts (numba's own caches go by both): a build,
a second checkout and an install share what one of them compiled.

The parent directory is ``$POLAR_NAV_CACHE_DIR``, or ``kernels/`` in the environment that
``./polar`` made (``.venv``, one for all homes of a checkout), or
``$XDG_CACHE_HOME/polar_nav/kernels``, or ``~/.cache/polar_nav/kernels``. Where none can be
written, a directory of this user under the system's temporary directory takes its place. Nothing
but these kernels goes there: numba's own setting is left as the rest of the process wants it.

While ``./polar`` compiles all kernels in the background, a process that misses one waits for it
(`background`).
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite.binding as llvm
import numba
from numba.core.caching import FunctionCache, _CacheLocator
from numba.core.registry import CPUDispatcher

from .. import background, claims
from . import inner

F = TypeVar('F', bound=Callable[..., Any])

ENVIRONMENT_VARIABLE = 'POLAR_NAV_CACHE_DIR'
OWN_ENVIRONMENT = '.polar_setup'
"""File in an environment that ``./polar`` made."""
KERNELS = Path(__file__).parent
_KERNEL = re.compile(r'^@(?:kernel|routine)\ndef (\w+)', re.MULTILINE)
_RELATIVE_IMPORT = re.compile(
    r'^[ \t]*from[ \t]+(\.+)([\w.]*)[ \t]+import[ \t]*(\([^)]*\)|[^\n]*)', re.MULTILINE
)
_NAME = re.compile(r'\w+')
_ORDER = KERNELS.parent / 'order.py'
"""Numbers that kernels are compiled with, though it is no kernel."""


def folder_of(source: Path) -> Path:
    """Folder named ``kernels`` that a source file lies in; its own folder where there is none."""
    return next((folder for folder in source.parents if folder.name == 'kernels'), source.parent)


@cache
def sources_of(source: Path) -> tuple[Path, ...]:
    """Files that a kernel file is compiled from: itself and all it imports in its folder."""
    folder = folder_of(source)
    found: set[Path] = set()
    waiting = [source]
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting.extend(_imported(path, folder))
    return tuple(sorted(found))


@cache
def _imported(source: Path, folder: Path) -> tuple[Path, ...]:
    """Files in a folder that the relative imports of *source* name, where they exist.

    Found by their form: to parse all files took every process seconds before it began, and paths
    that are objects take five times as long as these strings.
    """
    inside = f'{folder}{os.sep}'
    found: dict[str, None] = {}
    for dots, module, names in _RELATIVE_IMPORT.findall(_content(source).decode()):
        package = os.path.join(source.parents[len(dots) - 1], *module.split('.'))  # noqa: PTH118
        for place in (package, *(f'{package}{os.sep}{name}' for name in _NAME.findall(names))):
            for path in (f'{place}.py', f'{place}{os.sep}__init__.py'):
                if path.startswith(inside) and os.path.isfile(path):  # noqa: PTH113
                    found[path] = None
    return tuple(map(Path, found))


@cache
def _content(source: Path) -> bytes:
    """What a file held when this process read it first."""
    return source.read_bytes()


def cache_key(source: Path) -> str:
    """Hash of the sources that *source* is compiled from, of `order`, numba and the CPU."""
    digest = hashlib.sha256()
    folder = folder_of(source)
    names = {path.relative_to(folder).as_posix(): path for path in sources_of(source)}
    for name, path in [*sorted(names.items()), ('../order.py', _ORDER)]:
        text = _content(path)
        digest.update(f'{name} {len(text)}\n'.encode())
        digest.update(text)
    digest.update(_compiler().encode())
    return digest.hexdigest()


@cache
def _compiler() -> str:
    cpu = numba.config.CPU_NAME or llvm.get_host_cpu_name()
    features = numba.config.CPU_FEATURES or llvm.get_host_cpu_features().flatten()
    return f'{numba.__version__} {cpu} {features}'


def _bases() -> list[Path]:
    """Candidate parents of the cache directory, best first."""
    chosen = os.environ.get(ENVIRONMENT_VARIABLE)
    if chosen:
        return [Path(chosen)]
    prefix = Path(sys.prefix)
    # Code is loaded from there anyway; who may write there may compile for all.
    bases = [_of_this_environment()] if (prefix / OWN_ENVIRONMENT).exists() else []
    xdg = os.environ.get('XDG_CACHE_HOME')
    bases += [Path(xdg) / 'polar_nav' / 'kernels'] if xdg else []
    home = os.environ.get('HOME')
    if home:
        bases.append(Path(home) / '.cache' / 'polar_nav' / 'kernels')
    return bases


def _writable(directory: Path) -> bool:
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            return True
    except OSError:
        return False


@cache
def _own_temporary_directory() -> Path:
    """A directory that only this user can write: compiled code is loaded from it."""
    base = Path(tempfile.gettempdir()) / f'polar_nav_kernels_{os.getuid()}'
    try:
        base.mkdir(mode=0o700, exist_ok=True)
        status = base.lstat()
        if base.is_symlink() or status.st_uid != os.getuid() or status.st_mode & 0o022:
            raise PermissionError(f'{base} belongs to somebody else')
    except OSError:
        base = Path(tempfile.mkdtemp(prefix='polar_nav_kernels_'))
    return base


@cache
def cache_directory(source: Path, suffix: str = '') -> Path:
    """Directory for compiled kernels of *source*: created, writable, the same at every call."""
    relative = source.relative_to(folder_of(source)).with_suffix('')
    name = f'{".".join(relative.parts)}-{cache_key(source)[:32]}{suffix}'
    for base in _bases():
        directory = base / name
        if _writable(directory):
            return directory
    directory = _own_temporary_directory() / name
    directory.mkdir(parents=True, exist_ok=True)
    return directory


def compiled() -> tuple[int, int]:
    """Number of kernels of this folder that are in the cache, and of all there are."""
    done = total = 0
    for source in sorted(KERNELS.rglob('*.py')):
        names = _KERNEL.findall(source.read_text(encoding='utf-8'))
        if not names:
            continue
        files = [file.name for file in cache_directory(source).rglob('*.nbi')]
        total += len(names)
        done += sum(
            any(file.startswith(f'{source.stem}.{name}-') for file in files) for name in names
        )
    return done, total


def kernel(function: F) -> F:
    """Compile *function* lazily, cached, without fastmath: same bits on the same CPU model.

    ``error_model='numpy'``: a division by zero gives inf or NaN, which the callers check, and not
    an exception from the middle of a step. ``_nrt=False`` takes numba's runtime away, so that a
    kernel that would allocate does not compile; ``forceinline`` saves the calls between kernels.
    Other kernels call it; what Python calls, too, is an `entry`. With ``NUMBA_DISABLE_JIT=1`` the
    Python function itself comes back.
    """
    return _compile(function, forceinline=True)


def routine(function: F) -> F:
    """Compile *function* as :func:`kernel` does, but call it: large, or called from many places.

    Inlining those everywhere would make the compiler slow and nothing fast.
    """
    return _compile(function, forceinline=False)


def apart(function: F) -> F:
    """Compile what `routine` has made once and by itself, for those that call it; see `inner`.

    For what is large and has several callers, which would each optimise it again.
    """
    if numba.config.DISABLE_JIT:
        return function
    return cast(F, _compile(cast(Any, function).py_func, forceinline=False, called=APART))


def entry(function: F) -> F:
    """Let Python call what `kernel` or `routine` has made, too.

    Numba then adds what turns Python's objects into arguments, name by name. Of kernels whose
    arguments are whole groups of arrays, that takes as long to compile as all the rest of them.
    """
    if numba.config.DISABLE_JIT:
        return function
    made = cast(Any, function)
    inlined = made.targetoptions['forceinline']
    return cast(F, _compile(made.py_func, forceinline=inlined, called=BY_PYTHON))


class Inner(CPUDispatcher):  # type: ignore[misc]  # numba has no types
    """A kernel that only kernels call.

    Python may call it as well, as tests do: it is then compiled a second time, as an entry.
    """

    _entry: Callable[..., Any] | None = None

    def __call__(self, *args: Any) -> Any:  # noqa: ANN401 - whatever the kernel takes
        """Return what the kernel returns."""
        if self._entry is None:
            inlined = self.targetoptions['forceinline']
            self._entry = _compile(self.py_func, forceinline=inlined, called=BY_TESTS)
        return self._entry(*args)


class ByContent(_CacheLocator):  # type: ignore[misc]  # numba has no types
    """Where numba keeps a kernel: in the directory of its sources' content."""

    _suffix = ''

    def __init__(self, source: Path, line: int) -> None:
        self._directory, self._line = cache_directory(source, self._suffix), line

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> ByContent:
        """Locator of a function in a file."""
        return cls(Path(py_file), py_func.__code__.co_firstlineno)

    def get_cache_path(self) -> str:
        """Directory of the kernel."""
        return str(self._directory)

    def get_source_stamp(self) -> str:
        """What has to be the same for a kernel to be loaded: the directory's name says it."""
        return self._directory.name

    def get_disambiguator(self) -> str:
        """What tells functions of one name in a file apart."""
        return str(self._line)


class ByContentForTests(ByContent):
    """The same for an `Inner` that Python called: apart from the kernel itself."""

    _suffix = '-entries'


class Kept(FunctionCache):  # type: ignore[misc]  # numba has no types
    """Cache of a kernel; who links it is told what is `apart` and has to be loaded before."""

    def __init__(self, function: Callable[..., Any], *, is_apart: bool) -> None:
        super().__init__(function)
        self._is_apart = is_apart

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401 - numba's
        """Return the compiled kernel, or None: it has to be compiled here."""
        found = super().load_overload(sig, target_context)
        if found is not None:
            found.library._reload_init.update(found.reload_init)
            self._tell(found)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:  # noqa: ANN401 - numba's
        """Keep a kernel that was compiled here."""
        super().save_overload(sig, data)
        self._tell(data)

    def _tell(self, compiled: Any) -> None:  # noqa: ANN401 - numba's
        if self._is_apart:
            f = self._py_func
            needed = inner.Needed(f.__module__, f.__name__, tuple(compiled.signature.args))
            compiled.library._reload_init.add(needed)


class Awaited(Kept):
    """Cache of a kernel that may be on its way."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401 - numba's
        """Return the compiled kernel, or None: it has to be compiled here."""
        look = partial(super().load_overload, sig, target_context)
        found = look()
        if found is None and background.is_compiler():
            # Of two processes that compile all kernels one compiles this; the other has it then.
            claims.claim(Path(self.cache_path).parent, self._claim(sig))
            found = look()
            if found is not None:
                claims.release(self._claim(sig))
        if found is not None or Path(self.cache_path).parent != _of_this_environment():
            return found
        return background.awaited(look)

    def save_overload(self, sig: Any, data: Any) -> None:  # noqa: ANN401 - numba's
        """Keep a kernel that was compiled here."""
        super().save_overload(sig, data)
        claims.release(self._claim(sig))

    def _claim(self, sig: Any) -> str:  # noqa: ANN401 - numba's
        return f'{self.cache_path}/{self._impl.filename_base} {sig}'


def _of_this_environment() -> Path:
    return Path(sys.prefix) / 'kernels'


@contextmanager
def _kept_by_content(source: Path, locator: type[ByContent]) -> Iterator[None]:
    """Have numba keep there what is decorated meanwhile; an older numba adds the path."""
    mine = {
        'CACHE_LOCATOR_CLASSES': f'{locator.__module__}.{locator.__qualname__}',
        'CACHE_DIR': str(cache_directory(source, locator._suffix)),
    }
    before = {name: getattr(numba.config, name, '') for name in mine}
    try:
        for name, value in mine.items():
            setattr(numba.config, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(numba.config, name, value)


BY_KERNELS, BY_PYTHON, BY_TESTS, APART = range(4)
"""Who calls a compiled function; `APART` is by kernels, too."""


def _compile(function: F, *, forceinline: bool, called: int = BY_KERNELS) -> F:
    if numba.config.DISABLE_JIT:
        return function
    options = {
        'nopython': True,
        'fastmath': False,
        'error_model': 'numpy',
        '_nrt': False,
        'forceinline': forceinline,
        'no_cfunc_wrapper': True,
        'no_cpython_wrapper': called in (BY_KERNELS, APART),
    }
    locator = ByContentForTests if called == BY_TESTS else ByContent
    source = Path(function.__code__.co_filename)
    with _kept_by_content(source, locator):
        compilers = {BY_KERNELS: inner.COMPILER, APART: inner.APART}
        if called in compilers:
            compiled = Inner(function, targetoptions=options, pipeline_class=compilers[called])
        else:
            compiled = CPUDispatcher(function, targetoptions=options)
        # What the set-up compiles is awaited.
        of_set_up = called != BY_TESTS and KERNELS in source.parents
        compiled._cache = (Awaited if of_set_up else Kept)(function, is_apart=called == APART)
    return cast(F, compiled)
