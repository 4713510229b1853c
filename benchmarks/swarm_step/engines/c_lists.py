"""The step in hand-written C on the lists that numba builds, and what its bytes cost alone."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.swarm_step.engines.numba_lists import NumbaLists
from benchmarks.swarm_step.scenes import Law, Scene

SOURCE = Path(__file__).with_name("step.c")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-shared", "-fPIC")
LONGEST_ROW = 248


class CLists(NumbaLists):
    """Lists by numba, steps by the machine's C compiler."""

    function = "take_step"

    def __init__(self, scene: Scene, law: Law, *, precision: str, threads: int) -> None:
        compiler = shutil.which("cc")
        if compiler is None:
            msg = "no C compiler `cc` on this machine"
            raise ImportError(msg)
        super().__init__(scene, law, precision=precision, threads=threads)
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
            msg = f"a row is longer than the {LONGEST_ROW} entries that step.c can hold"
            raise RuntimeError(msg)

    def _step(self, dock, here, origin, gains, there, moved) -> float:  # noqa: ANN001 - arrays
        arrays = self.first, self.end, self.entry, dock, self.dock_offset, here, origin
        inputs = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
        outputs = [ctypes.c_void_p(array.ctypes.data) for array in (there, moved)]
        numbers = map(self.number, gains)
        return float(self._compiled(ctypes.c_int64(len(here)), *inputs, *numbers, *outputs))


class Streaming(CLists):
    """The bytes of a step, read and written once: no engine on these lists can be faster."""

    function = "stream"
    computes = False
