"""The registry of all that has a kind and a name that users choose.

BUILT_IN names what the package brings as text, so that nothing imports it before it is used.
Plug-ins, see `plugins`, register more of the same kinds. An entry of a plug-in has the record of
its source, whose digest results state.
"""

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

from tiswarm.base.errors import InputError, did_you_mean

_PACKAGE = __name__.partition(".")[0]

BUILT_IN: Mapping[str, Mapping[str, str]] = {
    "method": {
        "virtual-force": "tiswarm.localization.settings:VirtualForceParams",
        "least-squares": "tiswarm.localization.peers.settings:LeastSquaresParams",
        "joint": "tiswarm.localization.settings:JointParams",
        "hop-by-hop": "tiswarm.localization.peers.settings:HopByHopParams",
        "online": "tiswarm.localization.online.settings:OnlineParams",
        "distributed": "tiswarm.localization.distributed.settings:DistributedParams",
        "none": "tiswarm.localization.settings:NoneParams",
        "relax": "tiswarm.localization.relax:RelaxParams",
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
    "strength": {
        "tension": "tiswarm.world.strength:tension",
        "shear": "tiswarm.world.strength:shear",
        "bending": "tiswarm.world.strength:bending",
        "von-mises": "tiswarm.world.strength:von_mises",
    },
    "force": {
        "contact": "tiswarm.engine.laws:contact",
        "lennard-jones": "tiswarm.engine.laws:lennard_jones",
    },
    "integrator": {
        "first-order": "tiswarm.engine.laws:first_order",
        "verlet": "tiswarm.engine.laws:verlet",
        "langevin": "tiswarm.engine.laws:langevin",
    },
    "terrain": {
        "plane": "tiswarm.world.ground.bodies:PlaneParams",
        "slab": "tiswarm.world.ground.bodies:SlabParams",
        "box": "tiswarm.world.ground.bodies:BoxParams",
        "cylinder": "tiswarm.world.ground.bodies:CylinderParams",
        "sphere": "tiswarm.world.ground.bodies:SphereParams",
        "heightfield": "tiswarm.world.ground.bodies:HeightsParams",
        "mesh": "tiswarm.world.ground.bodies:MeshParams",
    },
    "measure": {},
    "figure": {
        "error": "tiswarm.report.error_figures",
        "table": "tiswarm.report.table_figures",
        "curve": "tiswarm.report.curve_figures",
        "swarm": "tiswarm.report.pictures.swarm_figures",
        "suite": "tiswarm.report.suite_figure",
        "relax": "tiswarm.report.relax_figures",
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
        "bag": "tiswarm.formats.bags:read_bag",
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
sensor: a suite with its settings and price, see `sensing.suites`.
structure: the class of its settings, see `world.params`, in the order of the schema.
rule: the class of its settings, see `world.params`.
strength: a function of the loads of contacts, see `world.strength`.
force, integrator: a function of the kernel language, see `engine.laws`.
measure: a `records.measures.Measure`, of plug-ins alone; ours are the table MEASURES there.
figure: a module with a function `painters` and `CAPTIONS`, see `report.figures`.
export_format: a function of a view, which returns bytes by name of file.
import_format: a function of a file and assumptions, which returns a table of poses, or None if the
    file has another format.
channel: a function of the settings of `distributed`, see
    `localization.distributed.channels`.
"""


@dataclass(frozen=True, kw_only=True)
class Plugin:
    """Record of a plug-in's source: of a function or class that a session defines."""

    file: Path
    """File, or the first file of an installed package."""

    digest: str
    """Twelve hex digits of the source."""

    def __reduce__(self) -> tuple[Callable[..., "Plugin"], tuple[str, str, str]]:
        """Refuse to be sent to a worker: only files and packages can be loaded there.

        Raises:
            InputError: always.
        """
        problem = "workers cannot load what this session defines; name its file in plugins"
        raise InputError(problem, path=self.file)


@dataclass(frozen=True, kw_only=True, eq=False)
class Registered:
    """What a plug-in registered under a name."""

    plugin: Plugin
    value: Any


_OF_CLASSES = ("structure", "rule", "terrain")
"""Kinds that plug-ins may add as classes; all others are functions."""

_entries: dict[tuple[str, str], Registered] = {}
"""By kind and name, what plug-ins registered."""

_sources: list[Plugin] = []
"""Plug-ins that are being loaded, the innermost last."""


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
    entry = _entries.get((kind, name))
    if entry is not None:
        return entry.value
    if name not in BUILT_IN[kind]:
        meant = did_you_mean(name, names(kind)) or f"; use {', '.join(names(kind))}"
        raise InputError(f"there is no {_words(kind, name)}{meant}", argument=argument)
    module, _, attribute = BUILT_IN[kind][name].partition(":")
    loaded = import_module(module)
    return getattr(loaded, attribute) if attribute else loaded


def registered(kind: str) -> dict[str, Registered]:
    """Return what plug-ins registered of a kind, such as `method`, by name."""
    return {name: entry for (kind_of, name), entry in _entries.items() if kind_of == kind}


def contents() -> tuple[Registered, ...]:
    """Return all that plug-ins registered; the key of a cache of what depends on it.

    Entries are equal only if they are the same, and a plug-in that is loaded again has new ones.
    """
    return tuple(_entries.values())


def register(kind: str, name: str, value: object, source: Callable[..., object]) -> None:
    """Register a value under a name; a plug-in that is loaded again replaces its own.

    Args:
        kind: Kind of the value.
        name: Name.
        value: The value, as BUILT_IN has it for the kind.
        source: Function of the plug-in, whose file and code count.

    Raises:
        InputError: the package or another plug-in has the name, or the source is no function of a
            kind that is one.
    """
    if kind not in _OF_CLASSES:
        require_function(kind, name, source)
    if name in BUILT_IN[kind]:
        problem = f"{_words(kind, name)} is taken by {_PACKAGE} itself; choose another name"
        raise InputError(problem)
    plugin = _sources[-1] if _sources else _defined_by(source)
    entry = _entries.get((kind, name))
    if entry is not None and entry.plugin.file != plugin.file:
        problem = f"{_words(kind, name)} is taken by {entry.plugin.file}; choose another name"
        raise InputError(problem)
    _entries[kind, name] = Registered(plugin=plugin, value=value)


def require_function(kind: str, name: str, value: object) -> None:
    """Refuse what is no function; the call of a class would only fail while something is computed.

    Args:
        kind: Kind of what a plug-in registers.
        name: Its name.
        value: What is decorated.

    Raises:
        InputError: it cannot be called, or is a class.
    """
    if callable(value) and not isinstance(value, type):
        return
    described = f"the class {value.__name__}" if isinstance(value, type) else repr(value)
    advice = "define a function, which may read numbers of its module"
    raise InputError(f"{_words(kind, name)} is {described}; {advice}")


@contextmanager
def registering(plugin: Plugin) -> Iterator[None]:
    """Let what is registered within the block be of a plug-in; after an error, nothing changes.

    What the same file registered before is forgotten.

    Raises:
        InputError: nothing was registered.
    """
    before = dict(_entries)
    for key, entry in before.items():
        if entry.plugin.file == plugin.file:
            del _entries[key]
    _sources.append(plugin)
    try:
        yield
        _require_entries(plugin)
    except BaseException:
        _entries.clear()
        _entries.update(before)
        raise
    finally:
        _sources.pop()


def _require_entries(plugin: Plugin) -> None:
    if not any(entry.plugin == plugin for entry in _entries.values()):
        raise InputError('registers nothing; decorate a function with @tiswarm.method("name")')


def clear() -> None:
    """Forget all that plug-ins registered."""
    _entries.clear()


def digest_of(source: bytes) -> str:
    """Return twelve hex digits of a source; the way line ends are written does not count."""
    return sha256(source.replace(b"\r\n", b"\n")).hexdigest()[:12]


def _words(kind: str, name: str) -> str:
    return f"{kind.replace('_', ' ')} {name}"


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
    return Plugin(file=file, digest=digest_of(source))
