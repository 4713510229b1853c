"""The scenarios that come with the package, by name."""

import os
from pathlib import Path

import yaml

from tiswarm.base.errors import InputError

_FOLDER = Path(__file__).parent / "files"


def shipped_scenarios() -> dict[str, Path]:
    """List the files of the scenarios by name, sorted."""
    return {path.stem: path for path in sorted(_FOLDER.glob("*.yaml"), key=lambda path: path.stem)}


def find_scenario(path: Path) -> Path:
    """Return the path of a file or, if there is none, that of the shipped scenario of this name.

    Raises:
        InputError: a name without folder and suffix is neither a file nor a shipped scenario, or
            both.
    """
    if str(path) != path.stem:
        return path
    # Unlike those of Path, functions of os.path do not raise for names that are too long.
    found, is_file = shipped_scenarios().get(str(path)), os.path.isfile(path)  # noqa: PTH113
    if found and is_file:
        problem = f"both a file here and a scenario of tiswarm's; name {path.absolute()} or {found}"
        raise InputError(problem, path=path)
    if found:
        return found
    if os.path.exists(path):  # noqa: PTH110
        return path
    problem = "neither a file nor a scenario of tiswarm's; tiswarm scenarios lists these"
    raise InputError(problem, path=path)


def describe_scenarios() -> list[str]:
    """List names and descriptions, in lines."""
    found = shipped_scenarios()
    width = max(map(len, found), default=0)
    texts = {name: yaml.safe_load(path.read_text())["description"] for name, path in found.items()}
    return [f"{name:<{width}}  {text}" for name, text in texts.items()]
