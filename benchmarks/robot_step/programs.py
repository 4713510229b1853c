"""Compiles the steps for this machine or for a Cortex-M4, and runs them there."""

import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tiswarm.base.aliases import Reals

SOURCES = Path(__file__).parent
STEPS = ("virtual_force", "rows", "neighborhood", "candidates")
STYLE = ("-std=c99", "-fno-math-errno")
M4 = ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-O2")
STRICT = ("-Wall", "-Wextra", "-Werror")
CROSS = "arm-none-eabi-"
QEMU = (
    "qemu-system-arm", "-M", "mps2-an386", "-display", "none", "-monitor", "none",
    "-serial", "none", "-chardev", "stdio,id=out", "-semihosting-config",
    "enable=on,target=native,chardev=out", "-icount", "shift=0", "-kernel",
)  # fmt: skip


class Outcome(NamedTuple):
    """A line that a program printed."""

    what: str
    which: int
    instructions: int
    stack: int
    """Bytes."""
    words: list[int]

    @property
    def values(self) -> Reals:
        """The words as the bits of floats."""
        real: Reals = np.array(self.words, np.uint32).view(np.float32).astype(np.float64)
        return real


def missing() -> str:
    """Name the first tool of `on_m4` that this machine lacks; empty if it has all."""
    for tool in (f"{CROSS}gcc", f"{CROSS}size", QEMU[0]):
        if shutil.which(tool) is None:
            return tool
    # GCC repeats the name of a library that it does not find.
    return "" if "/" in _run([f"{CROSS}gcc", *M4, "-print-file-name=libm.a"]) else "newlib"


def compiler_version() -> str:
    """Name the compiler of `on_m4`."""
    return _run([f"{CROSS}gcc", "--version"]).splitlines()[0]


def on_host(inputs: str, folder: Path, compiler: str = "cc") -> list[Outcome]:
    """Run the steps on this machine; instructions and stacks are 0."""
    program = _compiled(inputs, folder, [compiler, "-O2"], ["board_host.c"], ["-lm"])
    return _outcomes([str(program)])


def on_m4(inputs: str, folder: Path) -> list[Outcome]:
    """Run the steps on a Cortex-M4 of QEMU."""
    linked = ["-nostartfiles", f"-Wl,-T,{SOURCES / 'board_m4.ld'}", "-lm", "-lc"]
    program = _compiled(inputs, folder, [f"{CROSS}gcc", *M4, *STRICT], ["board_m4.c"], linked)
    return _outcomes([*QEMU, str(program)])


def sizes(folder: Path) -> dict[str, tuple[int, int]]:
    """Read code and static memory of each step in the folder of `on_m4` [bytes]."""
    found = {}
    for step in STEPS:
        done = _run([f"{CROSS}size", str(folder / f"{step}.o")])
        text, data, bss = map(int, done.splitlines()[1].split()[:3])
        found[step] = text, data + bss
    return found


def size_of_log(folder: Path) -> int:
    """Read the code of the only function that the steps take of the C library [bytes]."""
    lines = _run([f"{CROSS}nm", "-S", str(folder / "steps")]).splitlines()
    return sum(int(line.split()[1], 16) for line in lines if line.endswith("logf"))


def _compiled(
    inputs: str, folder: Path, compiler: list[str], board: list[str], linked: list[str]
) -> Path:
    (folder / "inputs.h").write_text(inputs)
    objects = []
    for source in [*(f"{step}.c" for step in STEPS), "main.c", *board]:
        objects.append(str(folder / source.replace(".c", ".o")))
        file = str(SOURCES / source)
        _run([*compiler, *STYLE, f"-I{folder}", "-c", file, "-o", objects[-1]])
    program = folder / "steps"
    _run([*compiler, *objects, *linked, "-o", str(program)])
    return program


def _outcomes(command: list[str]) -> list[Outcome]:
    found = []
    for line in _run(command).splitlines():
        what, *words = line.split()
        which, instructions, stack, *values = (int(word, 16) for word in words)
        found.append(Outcome(what, which, instructions, stack, values))
    return found


def _run(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr}")
    return done.stdout
