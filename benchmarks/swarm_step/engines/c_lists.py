"""C: the step on the neighbor lists that numba builds, and its streaming bound."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.swarm_step.engines.numba_lists import NumbaLists
from benchmarks.swarm_step.scenes import Scene, StepParams

SOURCE = Path(__file__).with_name("step.c")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-shared", "-fPIC")
LONGEST_ROW = 248


class CLists(NumbaLists):
    """Neighbor lists by numba, steps by the C compiler of the machine."""

    function = "take_step"

    def __init__(self, scene: Scene, params: StepParams, *, precision: str, threads: int) -> None:
        compiler = shutil.which("cc")
        if compiler is None:
            msg = "this machine has no C compiler `cc`; install one"
            raise ImportError(msg)
        super().__init__(scene, params, precision=precision, threads=threads)
        self.pointer = np.ctypeslib.ndpointer(self.real, flags="C")
        self.number = ctypes.c_double if precision == "float64" else ctypes.c_float
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder) / "step.so"
            real = "double" if precision == "float64" else "float"
            command = [compiler, *FLAGS, f"-DREAL={real}", "-o", library, SOURCE, "-lm"]
            subprocess.run(command, check=True)  # noqa: S603 - the compiler of this machine
            self._compiled = getattr(ctypes.CDLL(library), self.function)
        self._compiled.restype = self.number

    def _build(self, dock) -> None:  # noqa: ANN001 - an array
        super()._build(dock)
        if (self.end - self.first).max() > LONGEST_ROW:
            msg = f"a row has more than the {LONGEST_ROW} entries that step.c supports"
            raise RuntimeError(msg)

    def _step(self, dock, here, origin, gains, there, moved) -> float:  # noqa: ANN001 - arrays
        arrays = self.first, self.end, self.entry, dock, self.dock_offset, here, origin
        inputs = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
        outputs = [ctypes.c_void_p(array.ctypes.data) for array in (there, moved)]
        numbers = map(self.number, gains)
        return float(self._compiled(ctypes.c_int64(len(here)), *inputs, *numbers, *outputs))


class ByHand(CLists):
    """Docks loaded and transposed by hand: near what a processor can do on such lists."""

    function = "take_step_by_fours"


class Streaming(CLists):
    """Reads and writes the bytes of a step once: a lower bound for engines on these lists."""

    function = "stream"
    computes = False
