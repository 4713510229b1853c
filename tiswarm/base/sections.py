"""Sections of settings that a name of the registry selects, and names of the registry as settings.

A section is checked in two steps: its key that names a method, a structure or a rule selects a
class, and that class checks the section. Names are looked up as a section is checked, so those of a
plug-in count from when it is loaded.

    structure: Annotated[GrowthParams, Section("structure")]
    channel: Annotated[str, NameOf("channel")]
"""

import ast
import inspect
import json
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import (
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
)
from pydantic.dataclasses import dataclass as checked_dataclass
from pydantic.errors import PydanticSchemaGenerationError
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticKnownError, core_schema

from tiswarm.base.errors import InputError
from tiswarm.base.params import STRICT
from tiswarm.base.plugins import PluginError, call_plugin
from tiswarm.base.registry import Plugin, get, names, registered

SELECTORS: Mapping[str, str] = {
    "method": "method",
    "structure": "kind",
    "rule": "name",
    "terrain": "kind",
}
"""By kind that has settings, the key of a section that names one of the kind."""


@dataclass(frozen=True)
class Section:
    """Annotation of a section of settings: a key of it selects the class that checks it."""

    kind: str
    """Kind of the registry, one of those in SELECTORS."""

    by_name: bool = False
    """Whether a name alone stands for the section with its defaults."""

    def __get_pydantic_core_schema__(
        self, _source: object, _handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Let pydantic check a section by `_checked`; it writes one as the class of its value."""
        return core_schema.with_info_plain_validator_function(self._checked)

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """List the sections of all names that the registry has now."""
        choices = {name: get(self.kind, name).__pydantic_core_schema__ for name in names(self.kind)}
        section = core_schema.tagged_union_schema(choices, discriminator=self._selector)
        if not self.by_name:
            return handler(section)
        forms = {"name": _one_of(self.kind), "settings": section}
        return handler(core_schema.tagged_union_schema(forms, discriminator=_form_of))

    def _checked(self, value: object, info: ValidationInfo) -> object:
        is_section = isinstance(value, Mapping) or hasattr(value, self._selector)
        if self.by_name and not is_section:
            return _with_defaults(self.kind, value)
        name = self._name_in(value)
        if name not in names(self.kind):
            listed = ", ".join(repr(choice) for choice in names(self.kind))
            raise _mistake_at(
                self._selector,
                "union_tag_invalid",
                value,
                discriminator=repr(self._selector),
                tag=str(name),
                expected_tags=listed,
            )
        checks = _adapter(get(self.kind, str(name)))
        if info.mode == "json":  # only from JSON does strict validation accept lists for tuples
            return checks.validate_json(json.dumps(value))
        return checks.validate_python(value)

    @property
    def _selector(self) -> str:
        return SELECTORS[self.kind]

    def _name_in(self, value: object) -> object:
        """Return what a section, as data or as an object, has as its name."""
        if isinstance(value, Mapping):
            if self._selector not in value:
                raise _mistake_at(self._selector, "missing", value)
            return value[self._selector]
        if not hasattr(value, self._selector):
            raise PydanticKnownError("dict_type")
        return getattr(value, self._selector)


@dataclass(frozen=True)
class NameOf:
    """Annotation of a setting that is a name of the registry."""

    kind: str
    """Kind of the registry."""

    def __get_pydantic_core_schema__(
        self, _source: object, _handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Let pydantic check a name by the registry."""
        return core_schema.no_info_plain_validator_function(self._checked)

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """List all names that the registry has now."""
        return handler(_one_of(self.kind))

    def _checked(self, value: object) -> object:
        return _require_name(self.kind, value)


class SendsPlugins:
    """Base of settings with names of the registry: a worker loads the plug-ins of these first."""

    def __reduce_ex__(self, protocol: Any) -> Any:  # noqa: ANN401 - of any version
        """Send the plug-ins ahead."""
        usual: Any = super().__reduce_ex__(protocol)
        make, arguments, *state = usual
        plugins = _plugins_named_by(self)
        if not plugins:
            return make, arguments, *state
        return _call_after, (plugins, make, *arguments), *state


def settings_class(
    kind: str,
    name: str,
    settings: type[Any] | None,
    base: type[Any],
    namespace: Mapping[str, object],
) -> Any:  # noqa: ANN401 - a class
    """Make the class that checks a section from a class of a plug-in.

    The class of the plug-in may check values in its `__post_init__`: a ValueError is a mistake of
    the section.

    Args:
        kind: Kind of the registry.
        name: Name by which scenarios select the section.
        settings: Dataclass whose fields are further keys, described by the docstrings below them.
        base: Base class of the section; unless that is `settings` or derived from it,
            `settings_object` makes objects of `settings`.
        namespace: Further attributes.

    Raises:
        InputError: a field cannot be checked.
    """
    key = SELECTORS[kind]
    noun = "kind" if kind == "structure" else kind
    selector: Any = Annotated[Literal[name], Field(description=f"Name of the {noun}.")]
    annotations: dict[str, Any] = {key: selector}
    attributes: dict[str, Any] = {key: name, **namespace, "__reduce__": _sent(kind)}
    check = _check_of(kind, settings, base)
    if check is not None:
        attributes["__post_init__"] = _guarded(kind, name, check)
    if settings is not None:
        hints = get_type_hints(settings, include_extras=True)
        texts = _texts(settings)
        for setting in fields(settings):
            if setting.name == key or not setting.init:
                continue
            text = texts.get(setting.name) or _inherited_text(settings, setting.name)
            description = Field(description=text)
            annotations[setting.name] = Annotated[hints[setting.name], description]
            if setting.default is not MISSING:
                attributes[setting.name] = setting.default
            elif setting.default_factory is not MISSING:
                attributes[setting.name] = field(default_factory=setting.default_factory)
    title = f"Own{''.join(word.capitalize() for word in name.split('-'))}Params"  # in the schema
    attributes["__doc__"] = (settings and settings.__doc__) or f"Settings of {name}."
    attributes |= {"__module__": base.__module__, "__annotations__": annotations}
    unchecked = type(title, (base,), attributes)
    try:
        return checked_dataclass(unchecked, frozen=True, kw_only=True, config=STRICT)
    except PydanticSchemaGenerationError as error:
        problem = f"settings of {name}: {str(error).splitlines()[0]}; use types like float or str"
        raise InputError(problem) from error


def settings_object(kind: str, section: Any, settings: type[Any]) -> Any:  # noqa: ANN401 - of a plug-in
    """Make an object of a plug-in's class of settings from a section that `settings_class` checks.

    Args:
        kind: Kind of the registry.
        section: The checked section.
        settings: Dataclass of the plug-in.
    """
    names = [setting.name for setting in fields(settings) if setting.init]
    return settings(**{name: getattr(section, name) for name in names if name != SELECTORS[kind]})


def mistake_at(path: tuple[str | int, ...], problem: str) -> ValidationError:
    """Make an error of a validator whose problem is at a path within the value that it checks."""
    error: InitErrorDetails = {
        "type": "value_error",
        "loc": path,
        "input": None,
        "ctx": {"error": ValueError(problem)},
    }
    return ValidationError.from_exception_data("mistake", [error])


def _check_of(
    kind: str, settings: type[Any] | None, base: type[Any]
) -> Callable[[Any], object] | None:
    """Return what checks the values of a section as the class of a plug-in does; None if nothing.

    A class that is no base of the section checks values where an object of it is made.
    """
    if settings is None:
        return None
    if issubclass(base, settings):
        check: Callable[[Any], object] | None = getattr(settings, "__post_init__", None)
        return check
    return lambda section: settings_object(kind, section, settings)


def _guarded(kind: str, name: str, check: Callable[[Any], object]) -> Callable[[Any], None]:
    """Wrap a check of a plug-in: any exception is a mistake of the section, in one line."""

    def post_init(section: Any) -> None:  # noqa: ANN401 - of any plug-in
        refusals: list[Exception] = []

        def call() -> None:
            try:
                check(section)
            except (ValueError, AssertionError) as refusal:  # what pydantic takes from a check
                refusals.append(refusal)

        try:
            call_plugin(kind, name, call, method="__post_init__")
        except PluginError as error:
            raise ValueError(f"{error.problem}; correct the plug-in") from error
        if refusals:
            raise refusals[0]

    return post_init


@cache
def _adapter(settings: type[Any]) -> TypeAdapter[Any]:
    return TypeAdapter(settings)


def _with_defaults(kind: str, name: object) -> object:
    """Make the section that a name alone stands for."""
    settings = get(kind, _require_name(kind, name))
    try:
        return settings()
    except ValueError as error:
        problem = f"{name} has settings without defaults; write it like {{name: {name}, ...}}"
        raise ValueError(problem) from error


def _require_name(kind: str, value: object) -> str:
    """Return a value that is a name of a kind."""
    if isinstance(value, str) and value in names(kind):
        return value
    quoted = [repr(name) for name in names(kind)]
    expected = " or ".join([", ".join(quoted[:-1]), quoted[-1]]) if quoted[1:] else quoted[0]
    raise PydanticKnownError("literal_error", {"expected": expected})


def _form_of(value: object) -> str:
    """Say whether a value stands for a section by its name alone, or has settings."""
    return "settings" if isinstance(value, Mapping) else "name"


def _one_of(kind: str) -> CoreSchema:
    return core_schema.literal_schema([*names(kind)])


def _mistake_at(key: str, problem: str, section: object, **context: str) -> ValidationError:
    """Make an error of pydantic, one of its kinds, that is at a key of the section checked."""
    details: InitErrorDetails = {"type": problem, "loc": (key,), "input": section, "ctx": context}
    return ValidationError.from_exception_data("section", [details])


class Described(GenerateJsonSchema):
    """Generator of JSON Schemas that quote the docstrings below the fields of classes.

    Pydantic would read all of them as classes are made, which takes each command a tenth of a
    second.
    """

    def dataclass_schema(self, schema: core_schema.DataclassSchema) -> JsonSchemaValue:
        """Return the schema of a dataclass."""
        return _described(super().dataclass_schema(schema), schema["cls"])

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Return the schema of a model."""
        return _described(super().model_schema(schema), schema["cls"])


def _described(form: JsonSchemaValue, section: type[Any]) -> JsonSchemaValue:
    """Describe properties without a text of their own, in place."""
    for name, entry in form.get("properties", {}).items():
        if "description" not in entry and (text := _inherited_text(section, name)):
            entry["description"] = text
    return form


def _inherited_text(settings: type[Any], name: str) -> str | None:
    """Return the text of a field as the class of settings that it is from has it."""
    for section in settings.__mro__:
        checked = vars(section).get("__pydantic_fields__", {}).get(name)
        below = _texts_of_module(section.__module__).get(section.__name__, {}).get(name)
        text: str | None = (checked and checked.description) or below
        if text:
            return text
    return None


@cache
def _texts_of_module(module: str) -> dict[str, dict[str, str]]:
    """Read the docstrings below the fields of all classes of a module, by class and field."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError, SyntaxError):
        return {}
    return {node.name: _texts_below(node) for node in tree.body if isinstance(node, ast.ClassDef)}


def _texts(settings: type[Any]) -> dict[str, str]:
    """Read the docstrings below the fields of a class; empty where it has no source."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(settings)))
    except (OSError, TypeError, SyntaxError):
        return {}
    [declared, *_] = tree.body
    return _texts_below(declared) if isinstance(declared, ast.ClassDef) else {}


def _texts_below(declared: ast.ClassDef) -> dict[str, str]:
    """Read the docstrings below the fields of the source of a class."""
    texts = {}
    for entry, text in pairwise(declared.body):
        if not (isinstance(entry, ast.AnnAssign) and isinstance(entry.target, ast.Name)):
            continue
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
            texts[entry.target.id] = inspect.cleandoc(str(text.value.value))
    return texts


def _plugins_named_by(settings: Any) -> tuple[Plugin, ...]:  # noqa: ANN401 - a dataclass
    """List the plug-ins that the names of the registry in some settings are of."""
    plugins = []
    for setting in fields(settings):
        for note in getattr(setting.type, "__metadata__", ()):
            if isinstance(note, NameOf):
                entry = registered(note.kind).get(getattr(settings, setting.name))
                plugins += [entry.plugin] if entry else []
    return tuple(plugins)


def _sent(kind: str) -> Callable[[Any], tuple[Any, ...]]:
    """Return a `__reduce__` of settings that a plug-in registered, which sends it ahead."""

    def reduced(settings: Any) -> tuple[Any, ...]:  # noqa: ANN401 - of any plug-in
        name = getattr(settings, SELECTORS[kind])
        values = {setting.name: getattr(settings, setting.name) for setting in fields(settings)}
        plugin = registered(kind)[name].plugin
        return _call_after, ((plugin,), _made, kind, name, values)

    return reduced


def _made(kind: str, name: str, values: Mapping[str, Any]) -> Any:  # noqa: ANN401 - settings
    """Make settings by their name."""
    return get(kind, name)(**values)


def _call_after(_plugins: Sequence[Plugin], make: Callable[..., Any], *arguments: object) -> Any:  # noqa: ANN401 - as `make` returns it
    """Make an object on a worker; unpickling has loaded the plug-ins, which come first."""
    return make(*arguments)
