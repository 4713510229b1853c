"""What is installed, and what is handed out."""

import ast
import os
import re
import shutil
import subprocess
import sys
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

import tiswarm
from tiswarm.compute import lang

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).parents[1]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
PINS = (REPOSITORY / "constraints.txt").read_text().splitlines()

IMPORTED_AS = {  # modules that are not named after what brings them
    "PIL": "pillow",
    "backports": "backports.zstd",
    "mpl_toolkits": "matplotlib",
    "pydantic_core": "pydantic",
    "yaml": "pyyaml",
}
SAME_MODULE = {"open3d-cpu"}  # imported as open3d

REGISTRY = re.compile(r"pythonhoste[d]|pypi[.]org|index-ur[l]|find-link[s]|trusted-hos[t]")
HOME = re.compile(r"/hom[e]/\w|(?<![\w.])/roo[t]\b|/User[s]/\w|[A-Z]:\\User[s]\\")


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _names(requirements: list[str]) -> set[str]:
    return {_normal(re.split(r"[^\w.-]", requirement)[0]) for requirement in requirements}


def _imported() -> set[str]:
    """List what the package imports, anywhere in it, that Python itself does not bring."""
    modules = set()
    for file in (REPOSITORY / "tiswarm").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                modules.add(node.module.partition(".")[0])
    newer = {"compression"}  # of Python 3.14
    return modules - sys.stdlib_module_names - newer - {"tiswarm"}


def _handed_out() -> list[Path]:
    folders = (".ci", ".github", "benchmarks", "docs", "scenarios", "tests", "tiswarm")
    files = [file for folder in folders for file in (REPOSITORY / folder).rglob("*")]
    files += [file for file in REPOSITORY.iterdir() if file.name not in {".coverage", ".git"}]
    return [file for file in files if file.is_file() and "__pycache__" not in file.parts]


@pytest.mark.parametrize("module", ["matplotlib", "open3d", "pandas", "taichi"])
def test_importing_tiswarm_is_light(module):
    """`import tiswarm` loads none of the libraries that take long."""
    code = f"import sys, tiswarm; sys.exit({module!r} in sys.modules)"

    done = subprocess.run([sys.executable, "-c", code], check=False)

    assert done.returncode == 0


def test_types_are_handed_out():
    """A user's type checker reads our annotations if this file is installed."""
    tool = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]

    assert "py.typed" in tool["setuptools"]["package-data"]["tiswarm"]
    assert (REPOSITORY / "tiswarm" / "py.typed").is_file()


def test_the_version_is_said_once():
    """What is installed carries the version that the package states."""
    assert metadata.version("tiswarm") == tiswarm.__version__


def test_the_citation_names_this_version():
    """Whoever cites it names what they used."""
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())

    assert citation["version"] == tiswarm.__version__
    assert f"version = {{{tiswarm.__version__}}}" in (REPOSITORY / "README.md").read_text()
    assert citation["license"] == PROJECT["license"]
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()


def test_constraints_are_pins():
    """A line is a name, a version and at most a condition; no place to fetch it from."""
    pin = re.compile(r"[\w.-]+==[\w.!+]+( ?; [\w.'\" =<>!()-]+)?")

    assert [line for line in PINS if not pin.fullmatch(line)] == []


def test_every_dependency_is_pinned():
    """Runtime, extras and build: none is left to the day of the installation."""
    pyproject = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    wanted = sum(PROJECT["optional-dependencies"].values(), PROJECT["dependencies"])
    wanted += pyproject["build-system"]["requires"]

    assert _names(wanted) <= _names(PINS)


def _pinned_for(environment: dict[str, str]) -> dict[str, list[str]]:
    """Return the versions that are pinned in such an environment, by name: one, if all is well."""
    pins: dict[str, list[str]] = {}
    for pin in map(Requirement, PINS):
        if pin.marker is None or pin.marker.evaluate(environment):
            pins.setdefault(_normal(pin.name), []).append(str(pin.specifier).removeprefix("=="))
    return pins


def _brought() -> dict[str, str]:
    """List what dependencies and extras bring as far as it is installed: versions by name."""
    wanted = sum(PROJECT["optional-dependencies"].values(), PROJECT["dependencies"])
    waiting, seen = [*map(Requirement, wanted)], set[tuple[str, str]]()
    found = {}
    while waiting:
        needed = waiting.pop()
        for extra in ("", *needed.extras):
            key = (_normal(needed.name), extra)
            if key in seen or (needed.marker and not needed.marker.evaluate({"extra": ""})):
                continue
            seen.add(key)
            try:
                brought = metadata.requires(needed.name) or []
            except metadata.PackageNotFoundError:  # an extra that this machine lacks
                continue
            found[key[0]] = metadata.version(needed.name)
            waiting += [
                Requirement(f"{each.name}[{','.join(each.extras)}]" if each.extras else each.name)
                for each in map(Requirement, brought)
                if each.marker is None or each.marker.evaluate({"extra": extra})
            ]
    return {name: version for name, version in found.items() if name != "tiswarm"}


def test_everything_that_dependencies_bring_is_pinned():
    """A fresh environment has what this one was tested with, as far as this one has it."""
    assert _brought().keys() - _names(PINS) == set()


def test_an_environment_that_make_installed_has_the_pinned_versions():
    """All that dependencies brought, too; `make` installs again once pins change."""
    if not Path(sys.prefix, ".installed-dev").exists():
        pytest.skip("make did not install this environment")
    pins = _pinned_for({})

    assert {name: [version] for name, version in _brought().items()} == {
        name: pins.get(name) for name in _brought()
    }


@pytest.mark.parametrize("version", ["3.10.0", "3.11.2", "3.11.5", "3.12.0", "3.13.0", "3.14.0"])
@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_each_python_has_one_pin_that_fits(version, machine):
    """Whatever an installation asks for, one version is pinned, and the requirement allows it."""
    here = {"platform_machine": machine, "platform_system": "Linux"}
    here |= {"python_version": version.rpartition(".")[0], "python_full_version": version}
    pins = _pinned_for(here)
    wanted = sum(PROJECT["optional-dependencies"].values(), PROJECT["dependencies"])
    needed = [
        each
        for each in map(Requirement, wanted)
        if each.marker is None or each.marker.evaluate({**here, "sys_platform": "linux"})
    ]

    assert {_normal(each.name) for each in needed} & {"taichi", "quadrants"}
    for each in needed:
        [pinned] = pins[_normal(each.name)]
        assert pinned in each.specifier, each.name
    assert SpecifierSet(PROJECT["requires-python"]).contains(version)


def test_pythons_before_3_11_5_have_a_soupsieve_for_them():
    """Debian 12 has 3.11.2, on which `make test` found no version of soupsieve to install."""
    here = {"python_version": "3.11", "platform_machine": "x86_64", "platform_system": "Linux"}
    old, new = (_pinned_for({**here, "python_full_version": f"3.11.{k}"}) for k in (2, 5))

    assert (old["soupsieve"], new["soupsieve"]) == (["2.10"], ["4.1.3"])


def test_every_import_is_a_dependency():
    """What the package imports is what it or an extra asks for, no more and no less."""
    modules = _imported() | set(lang.LIBRARIES)  # these are imported by name
    needed = {_normal(IMPORTED_AS.get(module, module)) for module in modules}
    extras = {**PROJECT["optional-dependencies"], "bench": [], "dev": [], "docs": []}.values()

    assert needed == _names(sum(extras, PROJECT["dependencies"])) - SAME_MODULE


def test_no_file_names_a_registry_or_a_home():
    """The repository works for anybody: it knows no package server and nobody's folders."""
    found = []
    for file in _handed_out():
        text = file.read_bytes().decode(errors="ignore")
        found += [(file.name, hit) for rule in (REGISTRY, HOME) for hit in rule.findall(text)]

    assert found == []


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """Copy what a distribution is built from, so that leftovers of earlier builds are not in it."""
    source = tmp_path_factory.mktemp("source")
    for name in ("tiswarm", "scenarios"):
        leftovers = shutil.ignore_patterns("__pycache__")
        shutil.copytree(REPOSITORY / name, source / name, symlinks=True, ignore=leftovers)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, source / name)
    return source


@pytest.fixture(scope="module")
def wheel(source, tmp_path_factory) -> Path:
    """Build the wheel."""
    return _wheel_of(source, tmp_path_factory.mktemp("wheel"))


def _wheel_of(source: Path, out: Path) -> Path:
    _pip("wheel", source, "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", out)
    return next(out.iterdir())


def _content(wheel: Path) -> dict[str, int]:
    """List the files of a wheel with their checksums, without its own list of them."""
    with zipfile.ZipFile(wheel) as archive:
        return {
            entry.filename: entry.CRC
            for entry in archive.infolist()
            if not entry.filename.endswith("/RECORD")
        }


def _pip(*arguments: object) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    subprocess.run([*command, *map(str, arguments)], check=True)


def _run(python: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run tiswarm of an environment, in its folder: the checkout must not help."""
    command, folder = python.with_name("tiswarm"), python.parents[1]
    return subprocess.run(
        [command, *arguments], check=False, cwd=folder, capture_output=True, text=True
    )


@pytest.mark.trial
def test_the_lowest_versions_that_are_allowed_work():
    """Whoever keeps old libraries gets what the bounds of pyproject.toml promise."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("MAKE", "PYTEST_", "TISWARM_"))
    }

    done = subprocess.run(
        [shutil.which("make"), "lowest", f"PYTHON={sys.executable}"],
        check=False, cwd=REPOSITORY, env=kept, capture_output=True, text=True,
    )  # fmt: skip

    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


@pytest.fixture(scope="module")
def resolve(tmp_path_factory):
    """Resolve pinned run-time dependencies to wheels for a Python, a glibc and extras."""
    folder = tmp_path_factory.mktemp("resolver")
    venv.create(folder, with_pip=True)
    _pip("--python", folder / "bin" / "python", "install", "uv")

    def compiled(python: str, glibc: str, *extras: str) -> subprocess.CompletedProcess[str]:
        wanted = [word for extra in extras for word in ("--extra", extra)]
        system = f"x86_64-manylinux_{glibc}"
        command = [folder / "bin" / "uv", "pip", "compile", "--quiet", "pyproject.toml", *wanted]
        command += ["--only-binary", ":all:", "--constraint", "constraints.txt"]
        command += ["--python-version", python, "--python-platform", system]
        return subprocess.run(command, check=False, cwd=REPOSITORY, capture_output=True, text=True)

    return compiled


@pytest.mark.trial
@pytest.mark.parametrize("glibc", ["2_28", "2_31", "2_35"])
@pytest.mark.parametrize("python", ["3.10", "3.12", "3.13"])
def test_all_that_a_run_needs_has_wheels(resolve, python, glibc):
    """Nobody compiles a library on Debian 10 and later, or on systems of that age."""
    resolved = resolve(python, glibc)

    assert resolved.returncode == 0, resolved.stderr
    assert {"numpy", "scipy", "taichi"} <= _names(resolved.stdout.splitlines())


@pytest.mark.trial
@pytest.mark.parametrize(
    ("python", "glibc", "exists"),
    [
        ("3.10", "2_31", True),
        ("3.11", "2_31", True),
        ("3.12", "2_31", True),
        ("3.12", "2_28", False),
    ],
)
def test_open3d_has_wheels_where_the_readme_says(resolve, python, glibc, exists):
    """An older glibc has none, which also shows that the resolver looks at the system."""
    resolved = resolve(python, glibc, "open3d")

    assert (resolved.returncode == 0) == exists, resolved.stderr
    assert ("open3d-cpu" in _names(resolved.stdout.splitlines())) == exists


@pytest.mark.trial
def test_the_wheel_works_without_the_checkout(wheel, tmp_path):
    """An empty environment that sees the installed libraries runs a scenario that ships."""
    venv.create(tmp_path / "env")
    python = tmp_path / "env" / "bin" / "python"
    _pip("--python", python, "install", "--no-deps", "--no-index", wheel)
    [site] = (tmp_path / "env" / "lib").glob("python*/site-packages")
    libraries = [folder for folder in sys.path if folder.endswith("site-packages")]
    (site / "libraries.pth").write_text("\n".join(libraries))

    found = subprocess.run(
        [python, "-c", "import tiswarm; print(tiswarm.__file__)"],
        check=True, cwd=tmp_path, capture_output=True, text=True,
    ).stdout  # fmt: skip
    listed = _run(python, "scenarios", "--all")
    planned = _run(python, "run", "tower", "--plan")

    assert found.startswith(str(site))
    assert listed.returncode == 0, listed.stderr
    names = [line.split()[0] for line in listed.stdout.splitlines()]
    assert names == sorted(path.stem for path in (REPOSITORY / "scenarios").glob("*.yaml"))
    assert planned.returncode == 0, planned.stderr
    held = {name for name in _content(wheel) if "/templates/" in name}
    assert held == {
        f"tiswarm/report/templates/{path.name}"
        for path in (REPOSITORY / "tiswarm" / "report" / "templates").iterdir()
    }


@pytest.mark.trial
def test_a_source_distribution_builds_the_same_wheel(source, wheel, tmp_path):
    """Packagers build from it; it has the files that the checkout only links to."""
    build = "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])"
    subprocess.run(
        [sys.executable, "-c", build, str(tmp_path)], check=True, cwd=source, capture_output=True
    )
    [distribution] = tmp_path.glob("tiswarm-*.tar.gz")

    built = _wheel_of(distribution, tmp_path / "wheel")

    assert _content(built) == _content(wheel)


@pytest.mark.slow
@pytest.mark.parametrize("installer", ["pip", "pipx", "uvx"])
def test_the_wheel_installs_with_its_dependencies(wheel, tmp_path, installer):
    """A new environment gets what is pinned, and a small run draws its page."""
    venv.create(tmp_path / "env", with_pip=True)
    python = tmp_path / "env" / "bin" / "python"
    pins = REPOSITORY / "constraints.txt"
    command = [python.with_name("tiswarm")]
    if installer == "pip":
        _pip("--python", python, "install", "--constraint", pins, wheel)
    elif installer == "pipx":
        _pip("--python", python, "install", "pipx")
        command = [python.with_name("pipx"), "run", f"--pip-args=--constraint={pins}"]
        command += ["--spec", wheel, "tiswarm"]
    else:
        _pip("--python", python, "install", "uv")
        command = [python.with_name("uvx"), "--constraints", pins, "--from", wheel, "tiswarm"]

    done = subprocess.run(
        [*command, "run", "tower", "--set", "robots=10", "--set", "seeds=1"],
        check=False, cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    assert list(tmp_path.glob("reports/tower-*/report.html"))


def test_the_workflow_runs_the_check_on_every_python():
    """It calls what is there, on the versions that the package states."""
    workflow = yaml.safe_load((REPOSITORY / ".github/workflows/test.yml").read_text())
    job = workflow["jobs"]["test"]
    stated = [
        line.rpartition(" ")[2]
        for line in PROJECT["classifiers"]
        if re.fullmatch(r"Programming Language :: Python :: 3\.\d+", line)
    ]
    commands = [step["run"] for step in job["steps"] if "run" in step]

    assert job["strategy"]["matrix"]["python"] == stated
    assert commands[-1] == "sh .ci/run"
    assert (REPOSITORY / ".ci/run").exists()
    assert commands[0].startswith("make .venv/.installed-dev ")
    makefile = (REPOSITORY / "Makefile").read_text()
    for name in re.findall(r" ([A-Z]+)=", commands[0]):
        assert re.search(rf"^{name} =", makefile, re.MULTILINE), name
