"""Plug-ins: Python files of users, and installed packages, that add to the registry.

A file is loaded where a user names it, a package where it is installed with an entry point of the
group `tiswarm.plugins`. A scenario, a log or the folder of a run never loads one. All code of
plug-ins is called by `call_plugin`, so that a mistake in it is a line with its file.
"""

import linecache
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from tiswarm.base import registry
from tiswarm.base.errors import EnvironmentTroubleError, InputError, TiswarmError
from tiswarm.base.files import refuse_special
from tiswarm.base.registry import Plugin, digest_of

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from numpy.typing import NDArray

GROUP = "tiswarm.plugins"
"""Entry points of installed plug-ins."""


@dataclass(frozen=True, kw_only=True)
class LoadedPlugin(Plugin):
    """Record of a file or package; a worker that receives one loads the same source."""

    entry: str = ""
    """Name of the entry point; empty for a file that a user named."""

    def __reduce__(self) -> tuple[Callable[..., Plugin], tuple[str, str, str]]:
        """Load the plug-in where this arrives."""
        return _load_sent, (str(self.file), self.entry, self.digest)


_loaded: dict[Path, LoadedPlugin] = {}
"""By file, the plug-ins that were loaded from files."""


class PluginError(TiswarmError):
    """Code of a plug-in failed; the traceback says where."""

    def __init__(self, problem: str, details: str) -> None:
        """Take the error in a line, and its traceback."""
        super().__init__(problem)
        self.problem = problem
        self.details = details

    def __reduce__(self) -> tuple[type["PluginError"], tuple[str, str]]:
        """Keep both texts on the way from a worker."""
        return PluginError, (self.problem, self.details)


def load_plugins(files: Sequence[str | PathLike[str]] = ()) -> None:
    """Load the installed plug-ins, and these files; a file that has changed is loaded again.

    Raises:
        InputError: a file cannot be loaded, registers nothing, or uses a name that is taken.
        EnvironmentTroubleError: an installed plug-in cannot be loaded.
    """
    _load_installed()
    for file in [files] if isinstance(files, str | PathLike) else files:
        _load_file(Path(file))


def forget() -> None:
    """Forget all that plug-ins registered, and which files were loaded."""
    registry.clear()
    _loaded.clear()


def call_plugin(
    kind: str,
    name: str,
    call: Callable[[], Any],
    fault: Callable[[Any], str] | None = None,
    *,
    method: str = "",
    repeats: Callable[..., Any] | None = None,
    owner: object = None,
    hint: Callable[[BaseException], str] | None = None,
) -> Any:  # noqa: ANN401 - as the plug-in returns it
    """Call code of the plug-in that registered a name, and check what it returns.

    The working folder is the same afterwards.

    Args:
        kind: Kind of what the plug-in registered.
        name: Its name.
        call: Calls the code, and converts what it returns.
        fault: Says what the returned value wrongly is, a semicolon and what to return; empty if
            nothing is wrong.
        method: Name of the method that is called, if a class is registered.
        repeats: Function of the plug-in, if what it returns has to follow from the seed.
        owner: Object whose method that is.
        hint: Says what to look at after an exception of the code, after a semicolon; may be empty.

    Raises:
        PluginError: the code raised an exception, wanted to end the program, returned a wrong
            value, or drew random numbers that do not repeat.
    """
    from tiswarm.base.repeatable import watched  # noqa: PLC0415 - slow, and --help need not wait

    file = registry.registered(kind)[name].plugin.file
    called = f"{name}.{method}" if method else name
    try:
        with _same_folder(), nullcontext() if repeats is None else watched(repeats, owner):
            value = call()
    except (Exception, SystemExit) as error:
        line = _line_in(file, error)
        place = f"{file}:{line}" if line else str(file)
        details = "".join(traceback.format_exception(error))
        advice = hint(error) if hint else ""
        problem = f"{place}: {called} failed: {_in_words(error)}{advice}"
        raise PluginError(problem, details) from error
    problem = fault(value) if fault else ""
    if problem:
        message = f"{file}: {called} returned {problem}"
        raise PluginError(message, f"{message}\n")
    return value


def fault_of_numbers(values: "NDArray[Any]", farthest: float, where: str) -> str:
    """Say what numbers of a plug-in wrongly are; empty if nothing is wrong with them.

    Args:
        values: What the plug-in returned.
        farthest: Largest absolute value.
        where: What that means, as `within 1e10 R of the anchor`.
    """
    import numpy as np  # noqa: PLC0415 - slow, and --help need not wait

    if values.dtype.kind not in "fiu":
        return f"no real numbers, but {values.dtype}"
    if not np.isfinite(values).all():
        return "not finite"
    return "" if (np.abs(values) <= farthest).all() else f"not {where}"


@contextmanager
def _same_folder() -> Iterator[None]:
    """Return to the working folder at the end: relative paths of a run start there."""
    before = os.open(".", os.O_RDONLY)
    try:
        yield
    finally:
        os.fchdir(before)
        os.close(before)


def _load_file(named: Path) -> None:
    file = named.resolve()
    try:
        refuse_special(named, named.stat().st_mode)
        source = file.read_bytes()
    except OSError as error:
        problem = f"cannot be read: {error.strerror}; correct the path of the plug-in"
        raise InputError(problem, path=named) from error
    plugin = LoadedPlugin(file=file, digest=digest_of(source))
    if _loaded.get(file) == plugin:
        return
    linecache.checkcache(str(file))
    module = ModuleType(f"tiswarm_plugin_{plugin.digest}")
    module.__file__ = str(file)
    with _placing_mistakes(plugin, named), registry.registering(plugin), _same_folder():
        code = compile(source, str(file), "exec", dont_inherit=True)
        sys.modules[module.__name__] = module  # dataclasses and pickles look there
        exec(code, vars(module))  # noqa: S102 - the user named the file
    _loaded[file] = plugin


@cache
def _load_installed() -> None:
    from importlib import metadata  # noqa: PLC0415 - 10 ms, which --help need not wait

    for entry in metadata.entry_points(group=GROUP):
        try:
            plugin = _installed(entry)
            with (
                _placing_mistakes(plugin, plugin.file),
                registry.registering(plugin),
                _same_folder(),
            ):
                entry.load()
        except (ImportError, AttributeError, InputError) as error:
            problem = f"plug-in {entry.name} ({entry.value}): {error}; repair or uninstall it"
            raise EnvironmentTroubleError(problem) from error


def _installed(entry: "EntryPoint") -> LoadedPlugin:
    """Describe an installed plug-in by the source of its package, before it is imported."""
    spec = find_spec(entry.module.partition(".")[0])
    if spec is None or spec.origin is None:
        raise ImportError(f"there is no module {entry.module}")
    file = Path(spec.origin)
    files = sorted(file.parent.rglob("*.py")) if spec.submodule_search_locations else [file]
    source = b"".join(path.read_bytes() for path in files)
    return LoadedPlugin(file=file, digest=digest_of(source), entry=entry.name)


def _load_sent(file: str, entry: str, digest: str) -> Plugin:
    """Load the plug-in that another process uses.

    Raises:
        EnvironmentTroubleError: its source has changed, or is another one on this machine.
    """
    load_plugins([] if entry else [file])
    for plugin in (registered.plugin for registered in registry.contents()):
        # An installed package may be in another folder on this machine.
        is_placed = bool(entry) or plugin.file == Path(file)
        if is_placed and (getattr(plugin, "entry", None), plugin.digest) == (entry, digest):
            return plugin
    problem = f"{file}: the plug-in has changed since the run began; run it again"
    raise EnvironmentTroubleError(problem)


@contextmanager
def _placing_mistakes(plugin: Plugin, shown: Path) -> Iterator[None]:
    """Turn a mistake of a plug-in that is loaded within the block into a line with its place."""
    try:
        yield
    except EnvironmentTroubleError:
        raise
    except (Exception, SystemExit) as error:
        if isinstance(error, InputError) and error.path:  # of another file
            raise
        raise _mistake(error, plugin, shown) from error


def _mistake(error: BaseException, plugin: Plugin, shown: Path) -> InputError:
    """Say in a line what is wrong in a plug-in, and where."""
    if isinstance(error, InputError):
        return InputError(error.problem, path=shown, line=_line_in(plugin.file, error))
    if isinstance(error, SyntaxError):
        is_of_plugin = error.filename == str(plugin.file)
        line = error.lineno if is_of_plugin else None
        return InputError(f"{error.msg}; correct the plug-in", path=shown, line=line)
    problem = f"{_in_words(error)}; correct the plug-in"
    return InputError(problem, path=shown, line=_line_in(plugin.file, error))


def _in_words(error: BaseException) -> str:
    """Write an exception on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def _line_in(file: Path, error: BaseException) -> int | None:
    """Return the innermost line of a file that an exception passed."""
    frames = traceback.extract_tb(error.__traceback__)
    return next((f.lineno for f in reversed(frames) if Path(f.filename) == file), None)
