"""Compares the loads of the mechanics with those of MuJoCo and of PyNite, robot by robot.

    MUJOCO_GL=egl python -m benchmarks.physics            # 20 and 100 robots, 5 seeds of each
    MUJOCO_GL=egl python -m benchmarks.physics --quick    # 20 robots, 2 seeds
    python -m benchmarks.physics --rests                  # docks that rest on the ground, below

A structure is exported as MJCF and settles in MuJoCo. The constraint forces of the
welds give the wrench at each contact, and these give the axial force and the bending moment in each
link. The frame is the mechanics as it is by default, of beams that bend; in the rigid frame only
contacts do. Springs are rigid robots joined by the stiffness that MuJoCo documents for welds.
Without loops, each robot keeps its first contact, so that statics alone determines all loads.

At 1 % of gravity, robots sag by 1 % as much, and loads count a hundredfold. Without loops, only
that is compared: a cantilever of 100 robots sags by 0.1 R under all of gravity, and robots come to
touch others.

With --rests, 8 towers of 30 robots and 8 cantilevers of 20 that grew on ground that holds their
docks stand on docks that rest. In MuJoCo each foot is a contact in place of a weld, of the friction
stated, without torsion or rolling; a structure stands if no robot has moved by 0.5 R after 4 s at
10 % of gravity, where welds sag less.
Feet that are up to 0.02 R above the ground touch it from the start, as they do in the mechanics.

A table in Markdown is printed. Two pictures go to --out: the loads by robot, and worlds as MuJoCo
draws them after two seconds.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from PIL import Image

from tests import frames, oracle_frames
from tests.frames import LinkLoads
from tests.oracle_mujoco import Simulation
from tiswarm.base.robot import RobotGeometry
from tiswarm.formats.physics import encode_mjcf
from tiswarm.report.figure_style import PAGE_WIDTH, PALETTE, STYLE, label_plainly, new_figure, png
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import BridgeParams, CantileverParams, TowerParams

KINDS = {"tower": TowerParams(), "cantilever": CantileverParams()}
FORCE = 10.0
"""Load above which a robot calls for aid, F [weight of a dock]."""

LEAST = 0.1
"""Load of a robot below which differences are relative to this [weight of a dock, R]."""

SMALL = 0.005
"""Share below which a power of ten is shown [1]."""

LABELS = ("axial force [dock weights]", "bending [dock weights x R]")
DRAWN = {
    "without loops: MuJoCo, frame": ("without loops", "the frame"),
    "MuJoCo, springs": ("stiffness of welds", "springs"),
    "MuJoCo, rigid frame": ("contacts as beams", "the rigid frame"),
    "MuJoCo, frame": ("all as beams", "the frame"),
}
"""Pairs of the figure, with their titles and means."""

_EDGE = 480  # of a world's picture [pixels]


class Pair(NamedTuple):
    """Loads of the robots of some structures, by two means."""

    one: list[LinkLoads]
    other: list[LinkLoads]


def main() -> None:
    """Compare, print the table, draw the figure and the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="20 robots, 2 seeds")
    parser.add_argument("--out", type=Path, default=Path("docs/images"), metavar="FOLDER")
    parser.add_argument("--rests", action="store_true", help="docks that rest on the ground")
    options = parser.parse_args()
    if options.rests:
        compare_resting()
        return
    sizes, seeds = ((20,), 2) if options.quick else ((20, 100), 5)
    print(f"MuJoCo {mujoco.__version__}, seeds 0 to {seeds - 1}\n")
    print(
        "| structure | pair | axial: r | median | 95 % | bending: r | median | 95 % | same side |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    drawn: dict[str, dict[str, Pair]] = {}
    for robots in sizes:
        for kind, params in KINDS.items():
            found = compare(params, robots, seeds)
            drawn[kind] = found
            for name, pair in found.items():
                print(f"| {kind}, {robots} | {name} | {_cells(pair)} |", flush=True)
    (options.out / "physics-loads.png").write_bytes(draw_loads(drawn))
    draw_worlds(sizes[-1]).save(options.out / "physics-worlds.png", optimize=True)


def compare(params: TowerParams, robots: int, seeds: int) -> dict[str, Pair]:
    """Compare the loads of structures by all pairs of means."""
    pairs: dict[str, Pair] = defaultdict(lambda: Pair([], []))
    for history in grow(params, robots=robots, seeds=range(seeds), robot=RobotGeometry()):
        for name, one, other in _loads(history):
            pairs[name].one.append(one)
            pairs[name].other.append(other)
    return dict(pairs)


def _loads(history: History) -> Iterator[tuple[str, LinkLoads, LinkLoads]]:
    """Yield each pair of loads of a structure."""
    structure = frames.grown(history)
    (xml,) = encode_mjcf(frames.view_of(history)).values()
    tree = frames.tree(structure)
    springs = Simulation(xml).springs(structure)
    yield "without loops: MuJoCo, frame", _settled(xml, tree, 0.01), frames.link_loads(tree)
    yield "1 % of gravity: MuJoCo, springs", _settled(xml, structure, 0.01), springs
    settled = _settled(xml, structure, 1.0)
    yield "MuJoCo, springs", settled, springs
    beams, rigid = frames.link_loads(structure), frames.link_loads(structure, model="rigid")
    pynite = oracle_frames.beam_frame(structure, MechanicsParams(), sparse=True)
    yield "PyNite, frame", LinkLoads(pynite.axial, pynite.bending), beams
    yield "MuJoCo, rigid frame", settled, rigid
    yield "rigid frame, frame", rigid, beams
    yield "MuJoCo, frame", settled, beams


def _settled(xml: bytes, structure: frames.Standing, gravity: float) -> LinkLoads:
    """Loads in MuJoCo with the joints of a structure, at a share of gravity."""
    world = Simulation(xml, frames.joint_names(structure), gravity)
    world.settle()
    return world.loads(structure)


def _by_robot(loads: list[LinkLoads], part: int) -> Any:  # noqa: ANN401 - an array
    """Mean over the links of each robot of all structures, shape (robots,)."""
    return np.concatenate([each[part].mean(axis=1) for each in loads])


RESTING = {"tower": (TowerParams(anchors=3), 30), "cantilever": (CantileverParams(), 20)}
"""Structures that are put on docks that rest, and their robots."""

FRICTIONS = (0.3, 0.5, 1.0)
"""Coefficients of friction of docks on the ground [1]."""

_SEEDS = range(7000, 7008)

_FALLEN = 0.5
"""A structure whose robots moved farther does not stand [R]."""

_SHARE = 0.1
"""Share of gravity [1]."""

_LASTS = 4.0
"""Time that it is given to fall [s]."""


def compare_resting() -> None:
    """Compare which structures stand on docks that rest, and how feet share the load."""
    print(f"MuJoCo {mujoco.__version__}, seeds {_SEEDS[0]} to {_SEEDS[-1]}\n")
    print(
        "| structure | friction | stand | tip | slide | same in MuJoCo | feet: r | median | 95 % |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for kind, (params, robots) in RESTING.items():
        histories = grow(params, robots=robots, seeds=_SEEDS, robot=RobotGeometry())
        for friction in FRICTIONS:
            verdicts: list[str] = []
            same = 0
            loads: list[Any] = []
            for history in histories:
                structure = frames.grown(history)
                settings = MechanicsParams(model="rigid", ground="rests", friction=friction)
                solved = frames.solved(structure, settings)
                verdicts.append(solved.stability[0])
                world = Simulation(resting_world(history, structure, friction), gravity=_SHARE)
                world.run(_LASTS)
                stands = world.moved < _FALLEN
                same += stands == (verdicts[-1] == "stands")
                if stands and verdicts[-1] == "stands":
                    press = solved.loads(0).ground_force @ -settings.down
                    loads.append(np.column_stack([press, pressing(world, structure)]))
            counts = [verdicts.count(name) for name in ("stands", "tipped", "slid")]
            cells = ["", "", ""]
            if loads:
                by_frame, by_mujoco = np.concatenate(loads).T
                agreed = agreement(by_mujoco, by_frame)
                cells = [f"{agreed.correlation:.3f}", _share(agreed.median), _share(agreed.most)]
            row = [f"{kind}, {robots}", friction, *counts, f"{same} of {len(histories)}", *cells]
            print("| " + " | ".join(map(str, row)) + " |", flush=True)


def resting_world(history: History, structure: frames.Standing, friction: float) -> bytes:
    """Encode a structure whose feet are contacts with friction in place of welds."""
    (xml,) = encode_mjcf(frames.view_of(history)).values()
    root = ET.fromstring(xml)  # noqa: S314 - written a line before
    (option,) = root.iterfind("option")
    (equality,) = root.iterfind("equality")
    (contact,) = root.iterfind("contact")
    (softness,) = root.iterfind("default/equality")
    option.set("cone", "elliptic")
    option.set("impratio", "100")
    for weld in equality.findall("weld"):
        if weld.get("name", "").startswith("foot_"):
            equality.remove(weld)
    unit = Simulation(xml).radius
    for dock, foot in zip(structure.standing.tolist(), structure.foot, strict=True):
        robot, number = divmod(dock, len(structure.body))
        gap = float(np.linalg.norm(structure.dock[dock] - foot)) - history.robot.dock_radius
        margin = max(unit * gap, 0.0) + 1e-9
        ground = "ground"
        if history.terrain.has_edge:
            ground = "edge_0" if foot[0] > history.terrain.left_edge else "slab_0"
        ET.SubElement(
            contact, "pair", softness.attrib, geom1=f"dock_{robot}.{number}", geom2=ground,
            condim="3", friction=f"{friction} {friction} 0 0 0", margin=repr(margin),
        )  # fmt: skip
    return ET.tostring(root)


def pressing(world: Simulation, structure: frames.Standing) -> Any:  # noqa: ANN401 - an array
    """Forces of the ground on feet against gravity [weight of a dock], shape (G,)."""
    number = {dock: g for g, dock in enumerate(structure.standing.tolist())}
    press = np.zeros(len(number))
    docks = len(structure.body)
    for c in range(world.data.ncon):
        touching = world.data.contact[c]
        names = [world.model.geom(int(geom)).name for geom in touching.geom]
        foot = next(name for name in names if name.startswith("dock_"))
        robot, dock = map(int, foot.removeprefix("dock_").split("."))
        force = np.zeros(6)
        mujoco.mj_contactForce(world.model, world.data, c, force)
        along = touching.frame.reshape(3, 3).T @ force[:3]
        press[number[docks * robot + dock]] += abs(along[2]) / world.gravity
    return press


class Agreement(NamedTuple):
    """How loads by two means agree."""

    correlation: float
    median: float
    """Median of the relative difference [1]."""
    most: float
    """Its 95th percentile [1]."""


def agreement(one: Any, other: Any) -> Agreement:  # noqa: ANN401 - arrays
    """Compare loads by robot, shape (robots,).

    Differences are relative to the other loads, or to `LEAST` where these are less: links at right
    angles to all forces have no axial force at all.
    """
    away = np.abs(one - other) / np.maximum(other, LEAST)
    median, most = np.percentile(away, [50.0, 95.0])
    return Agreement(float(np.corrcoef(one, other)[0, 1]), float(median), float(most))


def _cells(pair: Pair) -> str:
    """Write how axial force and bending agree, and how many robots call for aid alike."""
    loads = [[_by_robot(means, part) for means in pair] for part in range(2)]
    cells = []
    for one, other in loads:
        found = agreement(one, other)
        cells += [f"{found.correlation:.3f}", _share(found.median), _share(found.most)]
    calls, rival = (loads[0][k] + loads[1][k] >= FORCE for k in range(2))
    return " | ".join([*cells, f"{100.0 * np.mean(calls == rival):.0f} %"])


def _share(value: float) -> str:
    """Write a share in percent, and a tiny one by its power of ten."""
    return f"{100.0 * value:.0f} %" if value >= SMALL else f"{value:.0e}"


def draw_loads(found: dict[str, dict[str, Pair]]) -> bytes:
    """Plot the loads of each robot by one means against those by another."""
    from matplotlib import rc_context

    with rc_context(STYLE):
        figure = new_figure(PAGE_WIDTH, 0.56 * PAGE_WIDTH)
        panels = figure.subplots(2, len(DRAWN), sharex="row", sharey="row")
        for (part, label), row in zip(enumerate(LABELS), panels, strict=True):
            for (name, (title, rival)), axes in zip(DRAWN.items(), row, strict=True):
                for (kind, pairs), color in zip(found.items(), PALETTE, strict=False):
                    one, other = (_by_robot(loads, part) for loads in pairs[name])
                    axes.loglog(other, one, ".", color=color, ms=2.5, mew=0, label=kind, alpha=0.6)
                axes.set(xlim=(0.5 * LEAST, None), ylim=(0.5 * LEAST, None))
                axes.axline((1.0, 1.0), (10.0, 10.0), color="0.4", lw=0.6, zorder=0)
                label_plainly(axes.xaxis)
                label_plainly(axes.yaxis)
                axes.set_xlabel(f"by {rival}")
                if part == 0:
                    axes.set_title(title)
            row[0].set_ylabel(f"{label},\nby MuJoCo")
        panels[0, 0].legend(loc="upper left", markerscale=3.0, handletextpad=0.1)
        return png(figure)


def draw_worlds(robots: int) -> Image.Image:
    """Draw a tower, a cantilever and a bridge after two seconds in MuJoCo, by its renderer."""
    images = []
    for params in (*KINDS.values(), BridgeParams()):
        history = grow(params, robots=robots, seeds=[0], robot=RobotGeometry())[0]
        (xml,) = encode_mjcf(frames.view_of(history)).values()
        world = Simulation(xml)
        world.run(2.0)
        images.append(_photo(world))
    return Image.fromarray(np.concatenate(images, axis=1))


def _photo(world: Simulation) -> Any:  # noqa: ANN401 - an array
    """Draw a world from the side, transparent around its solids."""
    places = world.data.xpos[1:]
    camera = mujoco.MjvCamera()
    camera.lookat = 0.5 * (places.min(axis=0) + places.max(axis=0))
    camera.distance = 1.45 * float(np.ptp(places, axis=0).max()) + 0.4
    camera.azimuth, camera.elevation = 75.0, -8.0
    world.model.vis.global_.offwidth = world.model.vis.global_.offheight = 2 * _EDGE
    with mujoco.Renderer(world.model, 2 * _EDGE, 2 * _EDGE) as renderer:
        renderer.update_scene(world.data, camera)
        color = renderer.render().copy()
        renderer.enable_segmentation_rendering()
        opacity = 255 * (renderer.render()[..., :1] >= 0)
    pixels = np.concatenate([color, opacity], axis=2).astype(np.uint8)
    return np.asarray(Image.fromarray(pixels).resize((_EDGE, _EDGE), Image.Resampling.BOX))


if __name__ == "__main__":
    main()
