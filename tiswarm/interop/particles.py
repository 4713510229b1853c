"""GSD, the format of HOOMD-blue: robots as rigid unions of spheres, contacts as bonds.

OVITO shows such files, freud analyzes them. The schema is `hoomd`, with shapes as in
https://gsd.readthedocs.io/en/stable/shapes.html. A frame for each join shows the growth; `step`
counts the robots that have joined. GSD has float32 numbers: positions are relative to the anchor,
whose place is the logged quantity `origin`.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import EnvironmentTroubleError
from tiswarm.report.swarm_view import SwarmView

_MOST_FRAMES = 200
"""Frames of a file; their size grows with frames x robots."""


def gsd_library() -> Any:  # noqa: ANN401 - no types
    """Import the module `gsd.hoomd`.

    Raises:
        EnvironmentTroubleError: the library gsd is not installed.
    """
    try:
        import gsd.hoomd  # noqa: PLC0415 - an extra
    except ImportError as error:
        problem = "GSD needs the library gsd; pip install 'tiswarm[gsd]'"
        raise EnvironmentTroubleError(problem) from error
    return gsd.hoomd


def encode_gsd(view: SwarmView) -> dict[str, bytes]:
    """Encode the structure, if the truth is known, and the estimate: bytes by name of file.

    Lengths are in the unit of the log. Particles have the logged quantities `robot` and, where
    known, `error` and `sd`. Robots whose pose is unknown are left out.

    Raises:
        EnvironmentTroubleError: the library gsd is not installed.
    """
    hoomd = gsd_library()
    poses = {"structure": view.pose} if view.has_truth else {}
    files = {}
    with TemporaryDirectory() as folder:  # the library writes to named files only
        for name, pose in {**poses, "estimate": view.estimated_pose}.items():
            path = Path(folder) / f"{name}.gsd"
            with hoomd.open(path, mode="w") as file:
                _append_frames(file, view, pose)
            files[path.name] = path.read_bytes()
    return files


def _append_frames(file: Any, view: SwarmView, pose: Reals) -> None:  # noqa: ANN401 - no types
    """Append a frame for each join, or for `_MOST_FRAMES` of them."""
    from gsd.hoomd import Frame  # noqa: PLC0415 - an extra

    unit = view.log.dock_radius
    known = np.flatnonzero(np.isfinite(pose).all(axis=1))
    place = unit * view.from_origin(pose)[known, :3]
    logged = {"robot": view.robot} | {
        name: unit * values
        for name, values in [("error", view.error), ("sd", view.sd)]
        if np.isfinite(values).any()
    }
    shape = {
        "type": "SphereUnion",
        "centers": (unit * view.dock_offset_body).tolist(),
        "diameters": [2.0 * unit] * len(view.dock_offset_body),
    }
    bonds = _bonds(view, known)
    reach = unit * (1.0 + np.linalg.norm(view.dock_offset_body, axis=1).max())
    frames = min(len(known), _MOST_FRAMES)
    for count in np.unique(np.linspace(1, len(known), frames).round().astype(int)).tolist():
        frame = Frame()
        frame.configuration.step = int(known[count - 1]) + 1
        # Positions have to be inside a box about the origin; no axis is periodic in fact.
        frame.configuration.box = [*(2.0 * (np.abs(place).max(axis=0) + reach)), 0.0, 0.0, 0.0]
        frame.particles.N = count
        frame.particles.types = ["robot"]
        frame.particles.type_shapes = [shape]
        frame.particles.position = place[:count]
        frame.particles.orientation = pose[known[:count], 3:]
        frame.particles.diameter = np.full(count, 2.0 * reach)
        made = bonds[bonds.max(axis=1, initial=0) < count]
        frame.bonds.N = len(made)
        frame.bonds.types = ["contact"]
        frame.bonds.group = made
        frame.log = {f"particles/{name}": values[known[:count]] for name, values in logged.items()}
        frame.log["origin"] = view.log.anchor_position
        file.append(frame)


def _bonds(view: SwarmView, known: Ints) -> Ints:
    """Pairs of robots in contact, each once, by their places among the known ones."""
    place = np.full(len(view.robot), -1)
    place[known] = np.arange(len(known))
    pairs: Ints = np.unique(place[view.log.contacts[:, [0, 2]]], axis=0)
    both: Ints = pairs[(pairs >= 0).all(axis=1)]
    return both
