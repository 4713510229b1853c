"""Plug-ins: Python files of a user that register methods and formats of their own.

A file is loaded where a user names it, or where it is installed with an entry point of the group
`tiswarm.plugins`. A scenario, a log or the folder of a run never loads one. What a plug-in
registers is known by its kind and name, with the digest of its source.
"""

import inspect
import linecache
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field
from pydantic.dataclasses import rebuild_dataclass

from tiswarm.base.errors import EnvironmentTroubleError, InputError, TiswarmError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from numpy.typing import NDArray

GROUP = "tiswarm.plugins"
"""Entry points of installed plug-ins."""


@dataclass(frozen=True, kw_only=True)
class Plugin:
    """Source of what was registered; a worker that receives one loads the same source."""

    file: Path
    """File, or the first file of an installed package."""

    digest: str
    """Twelve hex digits of the source."""

    entry: str = ""
    """Name of the entry point; empty for a file that a user named."""

    can_load: bool = True
    """Whether another process can load it; what a session defines it cannot."""

    def __reduce__(self) -> tuple[Callable[..., "Plugin"], tuple[str, str, str]]:
        """Load the plug-in where this arrives.

        Raises:
            InputError: other processes cannot load it.
        """
        if not self.can_load:
            problem = "workers cannot load what this session defines; name its file in plugins"
            raise InputError(problem, path=self.file)
        return _receive, (str(self.file), self.entry, self.digest)


@dataclass(frozen=True, kw_only=True)
class Registered:
    """What a plug-in registered under a name."""

    plugin: Plugin
    value: Any


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


_known: dict[tuple[str, str], Registered] = {}
_watchers: list[Callable[[], object]] = []
_loaded: dict[Path, Plugin] = {}
_loading: list[Plugin] = []


def watch(refresh: Callable[[], object], section: Any = None) -> None:  # noqa: ANN401 - a class
    """Call a function whenever what is registered has changed, and now if anything is.

    Args:
        refresh: The function.
        section: Parameter class in which the function changes types of fields; it is then rebuilt.
    """
    _watchers.append(refresh if section is None else lambda: _rebuild(section, refresh))
    if _known:
        _watchers[-1]()


def _rebuild(section: Any, retype: Callable[[], object]) -> None:  # noqa: ANN401 - a class
    """Rebuild a parameter class whose fields get other types.

    Pydantic reads docstrings of fields as it makes a class, but not as it rebuilds it, so the types
    carry them from then on.
    """
    fields = section.__dataclass_fields__
    texts = {name: each.description for name, each in section.__pydantic_fields__.items()}
    retype()
    for name, text in texts.items():
        notes = getattr(fields[name].type, "__metadata__", ())
        if text and not any(getattr(note, "description", None) for note in notes):
            fields[name].type = Annotated[fields[name].type, Field(description=text)]
    rebuild_dataclass(section, force=True)


def registered(kind: str) -> dict[str, Registered]:
    """Return what plug-ins registered of a kind, such as `method`, by name."""
    return {name: found for (which, name), found in _known.items() if which == kind}


def register(kind: str, name: str, value: object, source: Callable[..., object]) -> None:
    """Register a value under a name; a plug-in that is loaded again replaces its own.

    Args:
        kind: Kind of the value.
        name: Name, which must not be that of a built-in one.
        value: The value.
        source: Function of the plug-in, whose file and code count.

    Raises:
        InputError: another plug-in has the name.
    """
    plugin = _loading[-1] if _loading else _defined_by(source)
    owner = _known.get((kind, name))
    if owner is not None and owner.plugin.file != plugin.file:
        problem = f"{kind} {name} is taken by {owner.plugin.file}; choose another name"
        raise InputError(problem)
    _known[kind, name] = Registered(plugin=plugin, value=value)
    if not _loading:
        _refresh()


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
    """Forget all that is registered, and what was loaded from files."""
    _known.clear()
    _loaded.clear()
    _refresh()


def guarded(plugin: Plugin, name: str, call: Callable[[], Any]) -> Any:  # noqa: ANN401 - theirs
    """Call code of a plug-in; an exception in it becomes a line that says where it was raised.

    The working folder is the same afterwards.

    Raises:
        PluginError: the code raised an exception, or wanted to end the program.
    """
    try:
        with _same_folder():
            return call()
    except (Exception, SystemExit) as error:
        line = _line_in(plugin.file, error)
        place = f"{plugin.file}:{line}" if line else str(plugin.file)
        text = " ".join(f"{type(error).__name__}: {error}".split())
        details = "".join(traceback.format_exception(error))
        raise PluginError(f"{place}: {name} failed: {text}", details) from error


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


def _load_file(given: Path) -> None:
    file = given.resolve()
    try:
        source = file.read_bytes()
    except OSError as error:
        problem = f"cannot be read: {error.strerror}; correct the path of the plug-in"
        raise InputError(problem, path=given) from error
    plugin = Plugin(file=file, digest=_digest(source))
    if _loaded.get(file) == plugin:
        return
    linecache.checkcache(str(file))
    module = ModuleType(f"tiswarm_plugin_{plugin.digest}")
    module.__file__ = str(file)
    with _placed(plugin, given):
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
            with _placed(plugin, plugin.file):
                entry.load()
        except (ImportError, AttributeError, InputError) as error:
            problem = f"plug-in {entry.name} ({entry.value}): {error}; repair or uninstall it"
            raise EnvironmentTroubleError(problem) from error


def _installed(entry: "EntryPoint") -> Plugin:
    """Describe an installed plug-in by the source of its package, before it is imported."""
    spec = find_spec(entry.module.partition(".")[0])
    if spec is None or spec.origin is None:
        raise ImportError(f"there is no module {entry.module}")
    file = Path(spec.origin)
    files = sorted(file.parent.rglob("*.py")) if spec.submodule_search_locations else [file]
    source = b"".join(path.read_bytes() for path in files)
    return Plugin(file=file, digest=_digest(source), entry=entry.name)


@contextmanager
def _placed(plugin: Plugin, shown: Path) -> Iterator[None]:
    """Load a plug-in within the block: all of it or nothing, and mistakes with file and line."""
    before = dict(_known)
    for key in [key for key, found in _known.items() if found.plugin.file == plugin.file]:
        del _known[key]
    _loading.append(plugin)
    try:
        with _same_folder():
            yield
        _require_some(plugin)
    except BaseException as error:
        _known.clear()
        _known.update(before)
        is_theirs = isinstance(error, Exception | SystemExit)
        if not is_theirs or (isinstance(error, InputError) and error.path):
            raise
        raise _mistake(error, plugin, shown) from error
    finally:
        _loading.pop()
    _refresh()


def _require_some(plugin: Plugin) -> None:
    if not any(found.plugin == plugin for found in _known.values()):
        raise InputError('registers nothing; decorate a function with @tiswarm.method("name")')


def _mistake(error: BaseException, plugin: Plugin, shown: Path) -> InputError:
    """Say in a line what is wrong in a plug-in, and where."""
    if isinstance(error, InputError):
        return InputError(error.problem, path=shown, line=_line_in(plugin.file, error))
    if isinstance(error, SyntaxError):
        problem = f"{error.msg}; correct the plug-in"
        is_here = error.filename == str(plugin.file)
        return InputError(problem, path=shown, line=error.lineno if is_here else None)
    text = " ".join(f"{type(error).__name__}: {error}".split())
    line = _line_in(plugin.file, error)
    return InputError(f"{text}; correct the plug-in", path=shown, line=line)


def _line_in(file: Path, error: BaseException) -> int | None:
    """Return the innermost line of a file that an exception passed."""
    frames = traceback.extract_tb(error.__traceback__)
    return next((f.lineno for f in reversed(frames) if Path(f.filename) == file), None)


def _defined_by(function: Callable[..., object]) -> Plugin:
    """Describe the source of a function that was defined in this session."""
    file = Path(inspect.getfile(function))
    source = file.read_bytes() if file.is_file() else inspect.getsource(function).encode()
    return Plugin(file=file, digest=_digest(source), can_load=False)


def _digest(source: bytes) -> str:
    return sha256(source.replace(b"\r\n", b"\n")).hexdigest()[:12]


def _receive(file: str, entry: str, digest: str) -> Plugin:
    """Load the plug-in that another process uses.

    Raises:
        EnvironmentTroubleError: its source has changed, or is another one on this machine.
    """
    load_plugins([] if entry else [file])
    plugins = [each.plugin for each in _known.values()]
    found = next((p for p in plugins if p.entry == entry and (entry or p.file == Path(file))), None)
    if found is None or found.digest != digest:
        problem = f"{file}: the plug-in has changed since the run began; run it again"
        raise EnvironmentTroubleError(problem)
    return found


def _refresh() -> None:
    for refresh in _watchers:
        refresh()
