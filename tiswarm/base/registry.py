"""The registry of all that has a kind and a name that users choose, and plug-ins that add to it.

BUILT_IN names what the package brings as text, so that nothing imports it before it is used.

Plug-ins are Python files of a user that register what has such a kind. A file is loaded where a
user names it, or where it is installed with an entry point of the group `tiswarm.plugins`. A
scenario, a log or the folder of a run never loads one. What a plug-in registers is known by its
kind and name, with the digest of its source.
"""

import ast
import inspect
import linecache
import os
import sys
import textwrap
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.util import find_spec
from itertools import pairwise
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked_dataclass
from pydantic.dataclasses import rebuild_dataclass
from pydantic.errors import PydanticSchemaGenerationError

from tiswarm.base.errors import EnvironmentTroubleError, InputError, TiswarmError, did_you_mean
from tiswarm.base.params import STRICT

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from numpy.typing import NDArray

_PACKAGE = __name__.partition(".")[0]

GROUP = "tiswarm.plugins"
"""Entry points of installed plug-ins."""

BUILT_IN: Mapping[str, Mapping[str, str]] = {
    "method": {
        "virtual-force": "tiswarm.localization.settings:VirtualForceParams",
        "least-squares": "tiswarm.localization.peers.settings:LeastSquaresParams",
        "joint": "tiswarm.localization.settings:JointParams",
        "hop-by-hop": "tiswarm.localization.peers.settings:HopByHopParams",
        "online": "tiswarm.localization.online.settings:OnlineParams",
        "distributed": "tiswarm.localization.distributed.settings:DistributedParams",
    },
    "sensor": {
        "fireant-v3": "tiswarm.sensing.suites:FIREANT_V3",
        "coachbot-v1": "tiswarm.sensing.suites:COACHBOT_V1",
        "coachbot-v2": "tiswarm.sensing.suites:COACHBOT_V2",
        "zooids": "tiswarm.sensing.suites:ZOOIDS",
        "kilobot": "tiswarm.sensing.suites:KILOBOT",
        "freesn": "tiswarm.sensing.suites:FREESN",
        "m-blocks": "tiswarm.sensing.suites:M_BLOCKS",
        "atron": "tiswarm.sensing.suites:ATRON",
        "swarmbang": "tiswarm.sensing.suites:SWARMBANG",
    },
    "structure": {
        "tower": "tiswarm.world.params:TowerParams",
        "cantilever": "tiswarm.world.params:CantileverParams",
        "bridge": "tiswarm.world.params:BridgeParams",
        "chain": "tiswarm.world.params:ChainParams",
    },
    "rule": {"reactive-build": "tiswarm.world.params:ReactiveBuild"},
    "measure": {},
    "figure": {
        "error": "tiswarm.report.error_figures",
        "table": "tiswarm.report.table_figures",
        "curve": "tiswarm.report.curve_figures",
        "swarm": "tiswarm.report.pictures.swarm_figures",
        "suite": "tiswarm.report.suite_figure",
    },
    "export_format": {
        "csv": "tiswarm.formats.exports:encode_csv",
        "gif": "tiswarm.report.pictures.pictures:encode_growth_gif",
        "gltf": "tiswarm.report.pictures.scene:encode_gltf",
        "gsd": "tiswarm.formats.exports:encode_gsd",
        "mjcf": "tiswarm.formats.physics:encode_mjcf",
        "mcap": "tiswarm.formats.exports:encode_mcap",
        "mp4": "tiswarm.report.pictures.pictures:encode_growth_mp4",
        "parquet": "tiswarm.formats.exports:encode_parquet",
        "ply": "tiswarm.report.pictures.scene:encode_ply",
        "png": "tiswarm.report.pictures.pictures:encode_png",
        "pyfg": "tiswarm.formats.exports:encode_pyfg",
        "tum": "tiswarm.formats.exports:encode_tum",
        "webp": "tiswarm.report.pictures.pictures:encode_growth_webp",
        "wbt": "tiswarm.formats.physics:encode_wbt",
    },
    "import_format": {
        "bag": "tiswarm.formats.trajectories:read_bag",
        "tum": "tiswarm.formats.trajectories:read_tum",
        "gsd": "tiswarm.formats.trajectories:read_gsd",
        "mocap": "tiswarm.formats.trajectories:read_mocap",
        "table": "tiswarm.formats.columns:read_table",
    },
    "channel": {
        "touch": "tiswarm.localization.distributed.channels:lossy",
        "radio": "tiswarm.localization.distributed.channels:lossy",
    },
}
"""By kind and name, a module, or an attribute of one as `module:attribute`.

The kinds:

method: the class of its settings, see `localization.methods`, in the order of the schema.
sensor: a suite with its settings and price, see `parts.suites`.
structure: the class of its settings, see `world.params`, in the order of the schema.
rule: the class of its settings, see `world.params`.
measure: a `records.measures.Measure`, of plug-ins alone; ours are the table MEASURES there.
figure: a module with a function `painters` and `CAPTIONS`, see `report.figures`.
export_format: a function of a view, which returns bytes by name of file.
import_format: a function of a file and assumptions, which returns a table of poses, or None if the
    file has another format.
channel: a function of the settings of `distributed`, see `parts.channels`.
"""


def names(kind: str) -> tuple[str, ...]:
    """List the names of a kind: those of the package, then those of plug-ins."""
    return (*BUILT_IN[kind], *registered(kind))


def get(kind: str, name: str, argument: str = "") -> Any:  # noqa: ANN401 - see BUILT_IN
    """Return what a plug-in registered under a name, or import what the package brings.

    Args:
        kind: Kind, one of those in BUILT_IN.
        name: Name.
        argument: Argument of a function that has the name, for the error.

    Raises:
        InputError: neither the package nor a plug-in has the name.
    """
    if own := registered(kind).get(name):
        return own.value
    if name not in BUILT_IN[kind]:
        meant = did_you_mean(name, names(kind)) or f"; use {', '.join(names(kind))}"
        raise InputError(f"there is no {_words(kind, name)}{meant}", argument=argument)
    module, _, attribute = BUILT_IN[kind][name].partition(":")
    loaded = import_module(module)
    return getattr(loaded, attribute) if attribute else loaded


def _words(kind: str, name: str) -> str:
    return f"{kind.replace('_', ' ')} {name}"


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
    _watchers.append(refresh if section is None else lambda: rebuild(section, refresh))
    if _known:
        _watchers[-1]()


def rebuild(section: Any, retype: Callable[[], object]) -> None:  # noqa: ANN401 - a class
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


_NOUNS = {"name": "rule"}
"""What a key that selects a section names, where that is not the key."""


def own_section(
    name: str,
    key: str,
    settings: type[Any] | None,
    base: type[Any],
    namespace: Mapping[str, object],
) -> Any:  # noqa: ANN401 - a class
    """Make the parameter class of a section of scenarios from a class of a plug-in.

    Args:
        name: Name by which scenarios select the section.
        key: Key of that name.
        settings: Dataclass whose fields are further keys, described by the docstrings below them.
        base: Base class of the section.
        namespace: Further attributes.

    Raises:
        InputError: a field cannot be checked.
    """
    noun = _NOUNS.get(key, key)
    selects: Any = Annotated[Literal[name], Field(description=f"Name of the {noun}.")]
    kinds: dict[str, Any] = {key: selects}
    given: dict[str, Any] = {key: name, **namespace}
    if settings is not None:
        hints, texts = get_type_hints(settings, include_extras=True), _texts(settings)
        for each in fields(settings):
            if each.name != key:
                text = texts.get(each.name) or _inherited(settings, each.name)
                kinds[each.name] = Annotated[hints[each.name], Field(description=text)]
                if each.default is not MISSING:
                    given[each.name] = each.default
                elif each.default_factory is not MISSING:
                    given[each.name] = field(default_factory=each.default_factory)
    title = f"Own{''.join(word.capitalize() for word in name.split('-'))}Params"  # in the schema
    given["__doc__"] = (settings and settings.__doc__) or f"Settings of {name}."
    given |= {"__module__": base.__module__, "__annotations__": kinds}
    made = type(title, (base,), given)
    config = ConfigDict(**{**STRICT, "use_attribute_docstrings": False})
    try:
        return checked_dataclass(made, frozen=True, kw_only=True, config=config)
    except PydanticSchemaGenerationError as error:
        problem = f"settings of {name}: {str(error).splitlines()[0]}; use types like float or str"
        raise InputError(problem) from error


def _inherited(settings: Any, name: str) -> str | None:  # noqa: ANN401 - a class
    """Return the text of a field as the parameter class that it is from has it."""
    sections = (each.__dict__.get("__pydantic_fields__", {}) for each in settings.__mro__)
    return next((each[name].description for each in sections if name in each), None)


def _texts(settings: type[Any]) -> dict[str, str]:
    """Read the docstrings below the fields of a class; empty where it has no source."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(settings)))
    except (OSError, TypeError, SyntaxError):
        return {}
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    return {
        named.target.id: inspect.cleandoc(str(text.value.value))
        for named, text in pairwise(body)
        if isinstance(named, ast.AnnAssign) and isinstance(named.target, ast.Name)
        and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
    }  # fmt: skip


def sent_as(kind: str, key: str) -> Callable[[Any], tuple[Any, ...]]:
    """Return a `__reduce__` for settings from `own_section`, which sends their plug-in ahead."""

    def reduced(self: Any) -> tuple[Any, ...]:  # noqa: ANN401 - the settings
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return _made_again, (registered(kind)[values[key]].plugin, kind, key, values)

    return reduced


def _made_again(plugin: Plugin, kind: str, key: str, values: Mapping[str, Any]) -> Any:  # noqa: ANN401, ARG001
    """Make settings on a worker, where their plug-in has been loaded."""
    return get(kind, values[key])(**values)


def registered(kind: str) -> dict[str, Registered]:
    """Return what plug-ins registered of a kind, such as `method`, by name."""
    return {name: found for (which, name), found in _known.items() if which == kind}


def register(kind: str, name: str, value: object, source: Callable[..., object]) -> None:
    """Register a value under a name; a plug-in that is loaded again replaces its own.

    Args:
        kind: Kind of the value.
        name: Name.
        value: The value.
        source: Function of the plug-in, whose file and code count.

    Raises:
        InputError: the package or another plug-in has the name.
    """
    if name in BUILT_IN[kind]:
        problem = f"{_words(kind, name)} is taken by {_PACKAGE} itself; choose another name"
        raise InputError(problem)
    plugin = _loading[-1] if _loading else _defined_by(source)
    owner = _known.get((kind, name))
    if owner is not None and owner.plugin.file != plugin.file:
        problem = f"{_words(kind, name)} is taken by {owner.plugin.file}; choose another name"
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


def guarded(
    plugin: Plugin,
    name: str,
    call: Callable[[], Any],
    *,
    repeats: Callable[..., Any] | None = None,
    owner: object = None,
) -> Any:  # noqa: ANN401 - theirs
    """Call code of a plug-in; an exception in it becomes a line that says where it was raised.

    The working folder is the same afterwards.

    Args:
        plugin: The plug-in.
        name: What is called, for the error.
        call: The call.
        repeats: Function of the plug-in, if what it returns has to follow from the seed.
        owner: Object whose method that is.

    Raises:
        PluginError: the code raised an exception, or wanted to end the program, or drew random
            numbers that do not repeat.
    """
    from tiswarm.base.repeatable import watched  # noqa: PLC0415 - slow, and --help need not wait

    try:
        with _same_folder(), nullcontext() if repeats is None else watched(repeats, owner):
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
        is_whole = isinstance(error, EnvironmentTroubleError) or (
            isinstance(error, InputError) and error.path
        )
        if not is_theirs or is_whole:
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
    """Describe the source of a function that was defined in this session.

    Raises:
        InputError: the session keeps no source, whose digest results state.
    """
    try:
        file = Path(inspect.getfile(function))
        source = file.read_bytes() if file.is_file() else inspect.getsource(function).encode()
    except (OSError, TypeError) as error:
        problem = "this prompt keeps no source of what is typed; write it in a file or a notebook"
        raise InputError(problem) from error
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
