"""Structures as worlds of physics engines: MJCF, which MuJoCo loads, and WBT, those of Webots.

Both have the true structure, or the estimate where the truth is unknown, in SI units and relative
to the anchor. A robot is a rigid body. Its docks are spheres that collide, its links are capsules
that do not. The docks alone have mass: each weighs 1 N, so that forces in newtons are in the
mechanics' unit, the weight of a dock. The log's unit decides about lengths; docks of a log in R
have a nominal radius, which nobody measured.

Docks that touch are joined halfway between their centers, and docks on the ground where they touch
it: these are the contacts that the mechanics has as beams. Without ground, the anchors are joined
to the world.

MuJoCo joins by soft welds, which are springs at rest. With time constant t and impedance d
(`solref` and `solimp`), and A the sum over the joined bodies of their mean inverse inertia along or
about an axis (`body_invweight0`), the stiffness along each axis and about each axis is

    K = 1 / (t^2 (1 - d) A),    K' = 1 / (4 t^2 (1 - d) A')

(MuJoCo documentation, Modeling, "Solver parameters"; a weld measures half of an angle).
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.version import __version__
from tiswarm.compute.math import dock_offsets
from tiswarm.evaluation.paper import NOMINAL_RADIUS_MM
from tiswarm.records.messages import exact_text
from tiswarm.records.surface import GroundSurface
from tiswarm.records.terrain import EDGE_RADIUS, Terrain
from tiswarm.report.swarm_view import Slab, SwarmView, shown_slabs

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2]; a dock of 1 / 9.81 kg weighs 1 N."""

NOMINAL_RADIUS = NOMINAL_RADIUS_MM / 1000.0
"""Radius of a dock where the unit of the log is no unit of length [m]."""

_METERS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}

_TOUCHING = 0.02
"""Gap within which docks of a true structure touch [R], as in growth."""

_APART = 0.5
"""Gap beyond which docks of a true structure do not touch, although the log says so [R]."""

_LINK_RADIUS = 0.3
"""Radius of a link [R]."""

_PLANE = 100.0
"""Half the side of the part of a plane that is shown [R]."""

_INSET = 0.01
"""By how much a slab's edge is shorter than its box at both ends [R]."""

_ABOUT = (
    "SI units. Positions are relative to the anchor, which is at `origin` [m]. `R` is the radius "
    "of a dock [m]. A dock weighs 1 N."
)

_NOMINAL = (
    f"`R` is a nominal scale: the log has no unit of length, and {NOMINAL_RADIUS_MM} mm follow "
    "from 54 mm for 1.64 robot radii in a paper's table, not from a measured dock."
)

_NONE = -1
"""Row of the ground, and dock of a joint at a robot's center."""


class Joint(NamedTuple):
    """A rigid joint between a dock, or a center, and another dock or the ground."""

    row: int
    """Row of the robot."""
    dock: int
    """Its dock."""
    partner: int
    """Row of the other robot, or of the ground."""
    partner_dock: int
    """Dock of the other robot."""
    place: Reals
    """Where they are joined [R], shape (3,)."""
    axis: Reals
    """Unit vector out of the first dock, shape (3,)."""


class World(NamedTuple):
    """N robots whose poses are known, relative to the anchor."""

    view: SwarmView
    """What it shows."""
    unit: float
    """R [m]."""
    units: str
    """What readers of the file need to know of its units."""
    robots: list[int]
    """Ids of the robots."""
    center: Reals
    """Centers [R], shape (N, 3)."""
    turn: Rotation
    """Orientations, body to world."""
    color: Reals
    """Colors of the robots by join index, shape (N, 3)."""
    joints: list[Joint]
    """Contacts between docks, then those with the ground."""
    touching: list[tuple[int, int]]
    """Pairs of rows that touch or overlap, where they should or not; -1 is the ground."""
    slabs: list[Slab]
    """Slabs of the ground, relative to the anchor."""
    plane: float | None
    """Height of flat ground [R]; None if there is none."""
    surface: GroundSurface | None
    """Heights of uneven ground, relative to the anchor; None if there are none."""

    @property
    def about(self) -> dict[str, list[float]]:
        """Numbers that state units and place."""
        return {"R": [self.unit], "origin": (self.unit * self.view.origin).tolist()}

    def name(self, row: int) -> str:
        """Name of a robot."""
        return "world" if row == _NONE else f"robot_{self.robots[row]}"

    def joint_name(self, joint: Joint) -> str:
        """Name a joint by robots and docks: `contact_3.0_7.2`, `foot_0.1` or `anchor_0`."""
        dock = f"{self.robots[joint.row]}.{joint.dock}"
        if joint.dock == _NONE:
            return f"anchor_{self.robots[joint.row]}"
        if joint.partner == _NONE:
            return f"foot_{dock}"
        return f"contact_{dock}_{self.robots[joint.partner]}.{joint.partner_dock}"

    def in_body(self, row: int, place: Reals) -> Reals:
        """Return a place [R] in the frame of a robot, or of the ground [m]."""
        local = place if row == _NONE else self.turn[row].inv().apply(place - self.center[row])
        meters: Reals = self.unit * local
        return meters

    def ground_solids(self) -> Iterator[Reals]:
        """Yield middle and size of the box of a slab, and both ends of its edge [m], (4, 3)."""
        for rear, edge, low_y, high_y, top in self.slabs:
            z = top - EDGE_RADIUS
            middle = [0.5 * (rear + edge), 0.5 * (low_y + high_y), z]
            size = [abs(edge - rear), high_y - low_y, 2.0 * EDGE_RADIUS]
            # Faces of both that coincide would flicker.
            ends = [[edge, low_y + _INSET, z], [edge, high_y - _INSET, z]]
            yield self.unit * np.array([middle, size, *ends])


def build_world(view: SwarmView) -> World:
    """Choose the robots whose pose is known and that have not left, and find what joins them."""
    pose = view.from_origin(view.best_pose)
    shown = np.flatnonzero(np.isfinite(pose).all(axis=1) & ~view.log.is_gone)
    row_of = np.full(len(pose), _NONE)
    row_of[shown] = np.arange(len(shown))
    center = pose[shown, :3]
    wxyz = pose[shown, 3:]
    dock = center[:, None] + dock_offsets(wxyz, view.dock_offset_body)
    dock_list = dock.reshape(-1, 3)
    pairs = cKDTree(dock_list).query_pairs(2.0 + _TOUCHING, output_type="ndarray")
    touching_docks: Ints = np.sort(pairs, axis=1).reshape(-1, 2)
    terrain = view.terrain
    x, y, z = view.origin.tolist()
    depth: Reals = np.full(len(dock_list), -np.inf)
    slabs: list[Slab] = []
    surface = None
    if isinstance(terrain, GroundSurface):
        surface = terrain.moved(-view.origin)
        is_foot = np.zeros(dock.shape[:2], np.bool_)
        for i, d in surface.foot_dock.tolist():
            if row_of[i] >= 0:
                is_foot[row_of[i], d] = True
        depth[is_foot.ravel()] = 0.0
    elif terrain is not None and len(dock_list):
        depth = terrain.depth(dock_list + view.origin, 1.0)
        slabs = shown_slabs(terrain, dock_list + view.origin)
    joints = [*_contacts(view, row_of, dock, touching_docks), *_feet(view, row_of, dock, depth)]
    robot = np.arange(len(dock_list)) // dock.shape[1]
    touching = {(i, j) for i, j in robot[touching_docks].tolist() if i != j}
    touching |= {(i, _NONE) for i in robot[depth > -_TOUCHING].tolist()}
    touching |= {(joint.row, joint.partner) for joint in joints}
    meters = _METERS.get(view.log.length_unit)
    return World(
        view=view,
        unit=NOMINAL_RADIUS if meters is None else meters * view.log.dock_radius,
        units=f"{_ABOUT} {_NOMINAL}" if meters is None else _ABOUT,
        robots=view.robot[shown].tolist(),
        center=center,
        turn=Rotation.from_quat(wxyz, scalar_first=True),
        color=view.color_by_join[shown].round(3),
        joints=joints,
        touching=sorted(touching),
        slabs=[Slab(s.rear - x, s.edge - x, s.low_y - y, s.high_y - y, s.top - z) for s in slabs],
        plane=terrain.ground_z - z if isinstance(terrain, Terrain) and not slabs else None,
        surface=surface,
    )


def _contacts(view: SwarmView, row_of: Ints, dock: Reals, touching_docks: Ints) -> Iterator[Joint]:
    """Join docks that touch, by the number of the later robot.

    An estimate has the contacts of its log. A true structure lacks those that are false, and has
    those that the log misses.
    """
    logged = view.log.contacts[(row_of[view.log.contacts[:, [0, 2]]] >= 0).all(axis=1)]
    pairs = {(int(row_of[i]), a, int(row_of[j]), b) for i, a, j, b in logged.tolist()}
    if view.has_truth:
        true_pairs = np.stack(np.divmod(touching_docks, dock.shape[1]), axis=2).reshape(-1, 4)
        pairs |= {(i, a, j, b) for i, a, j, b in true_pairs.tolist() if i != j}
    for i, a, j, b in sorted(pairs, key=lambda pair: (pair[2], pair)):
        first = dock[i, a]
        second = dock[j, b]
        if not view.has_truth or np.linalg.norm(second - first) < 2.0 + _APART:
            yield Joint(i, a, j, b, 0.5 * (first + second), _unit(second - first))


def _feet(view: SwarmView, row_of: Ints, dock: Reals, depth: Reals) -> Iterator[Joint]:
    """Join docks to the ground on which they stand; without ground, anchors to the world."""
    log = view.log
    terrain = view.terrain
    if terrain is None:
        center = view.from_origin(view.best_pose)[:, :3]
        anchors = np.isfinite(log.known_position).all(axis=1) & (row_of >= 0)
        for i in np.flatnonzero(anchors).tolist():
            yield Joint(int(row_of[i]), _NONE, _NONE, _NONE, center[i], np.array([0.0, 0.0, -1.0]))
        return
    if isinstance(terrain, GroundSurface):
        for (i, d), place in zip(terrain.foot_dock.tolist(), terrain.foot, strict=True):
            row = int(row_of[i])
            if row >= 0:
                foot = place - view.origin
                yield Joint(row, d, _NONE, _NONE, foot, _unit(foot - dock[row, d]))
        return
    standing = {(int(row_of[i]), d) for i, d in log.ground_docks.tolist() if row_of[i] >= 0}
    if view.has_truth and not terrain.is_plane:  # logs do not have docks on an edge
        touching = np.argwhere(np.abs(depth.reshape(dock.shape[:2])) < _TOUCHING)
        standing |= {(i, d) for i, d in touching.tolist()}
    for i, d in sorted(standing):
        foot = terrain.foot(dock[i, d][None] + view.origin)[0] - view.origin
        yield Joint(i, d, _NONE, _NONE, foot, _unit(foot - dock[i, d]))


def _unit(way: Reals) -> Reals:
    """Scale a vector to length 1; estimated docks may coincide."""
    length = float(np.linalg.norm(way))
    unit: Reals = way / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    return unit


# --- MuJoCo ----------------------------------------------------------------------------------

_OPTION = {"timestep": "0.002", "gravity": f"0 0 {-GRAVITY}", "tolerance": "1e-12"}
_SOFTNESS = {"solref": "0.004 1", "solimp": "0.9999 0.9999 0.001 0.5 2"}
_SKY = {"type": "skybox", "builtin": "flat", "rgb1": "1 1 1", "width": "8", "height": "48"}
_LIGHT = {"pos": "0 0 10", "dir": "0.2 0.3 -1", "directional": "true", "castshadow": "false"}
_GEOMS = {
    "dock": {"type": "sphere", "mass": repr(1.0 / GRAVITY)},
    "link": {"type": "capsule", "mass": "0", "contype": "0", "conaffinity": "0"},
    "ground": {"rgba": "0.8 0.8 0.8 1"},
}


def encode_mjcf(view: SwarmView) -> dict[str, bytes]:
    """Encode the structure, or the estimate where the truth is unknown, for MuJoCo.

    Bodies, geoms and welds have the names of robots and docks. Robots that touch or overlap at the
    start do not collide.
    """
    world = build_world(view)
    root = ET.Element("mujoco", model=view.name or "case")
    root.append(ET.Comment(f" {world.units} tiswarm {__version__} "))
    _add(root, "option", _OPTION)
    default = _add(root, "default")
    _add(default, "equality", _SOFTNESS)
    for name, look in _GEOMS.items():
        _add(_add(default, "default", {"class": name}), "geom", look)
    custom = _add(root, "custom")
    for name, numbers in world.about.items():
        _add(custom, "numeric", name=name, data=exact_text(numbers))
    _add(_add(root, "asset"), "texture", _SKY)
    _add_heights(root, world)
    bodies = _add(root, "worldbody")
    _add(bodies, "light", _LIGHT)
    _add_ground(bodies, world)
    for row in range(len(world.robots)):
        _add_robot(bodies, world, row)
    contact = _add(root, "contact")
    equality = _add(root, "equality")
    for i, j in world.touching:
        _add(contact, "exclude", body1=world.name(i), body2=world.name(j))
    for joint in world.joints:
        bodies_of = {"body1": world.name(joint.row)}
        if joint.partner != _NONE:
            bodies_of["body2"] = world.name(joint.partner)
        place = world.in_body(joint.partner, joint.place)  # in the frame of the second body
        _add(equality, "weld", bodies_of, name=world.joint_name(joint), anchor=exact_text(place))
    ET.indent(root)
    return {"case.xml": ET.tostring(root, encoding="utf-8") + b"\n"}


def _add(
    parent: ET.Element, tag: str, attributes: Mapping[str, str] | None = None, **more: str
) -> ET.Element:
    return ET.SubElement(parent, tag, dict(attributes or {}), **more)


_BASE = 1.0
"""Thickness of uneven ground below its lowest height [R]."""


def _add_heights(root: ET.Element, world: World) -> None:
    """Add the heights of uneven ground, as parts of their range, in rows from the greatest y on."""
    if world.surface is None:
        return
    height, unit = world.surface.height, world.unit
    low, range_z = float(height.min()), float(np.ptp(height))
    half = 0.5 * world.surface.cell * (np.array(height.shape) - 1)
    share = (height - low) / max(range_z, 1e-9)
    sizes = [unit * size for size in (*half, max(range_z, 1e-9), _BASE)]
    asset = root.find("asset")
    _add(
        asset if asset is not None else _add(root, "asset"), "hfield", name="ground",
        nrow=str(height.shape[1]), ncol=str(height.shape[0]), size=exact_text(sizes),
        elevation=" ".join(f"{number:.5g}" for number in share.T[::-1].ravel().tolist()),
    )  # fmt: skip


def _add_ground(parent: ET.Element, world: World) -> None:
    """Add a plane, or for each slab a box and a cylinder along its edge."""
    look = {"class": "ground"}
    if world.plane is not None:
        plane = {
            "pos": exact_text([0.0, 0.0, world.unit * world.plane]),
            "size": exact_text([world.unit * half for half in (_PLANE, _PLANE, 1.0)]),
        }
        _add(parent, "geom", look | plane, name="ground", type="plane")
    if world.surface is not None:
        surface = world.surface
        middle = [*(0.5 * (surface.corner + surface.end)), float(surface.height.min())]
        place = {"pos": exact_text(world.unit * np.array(middle))}
        _add(parent, "geom", look | place, name="ground", type="hfield", hfield="ground")
    for n, (middle, size, *ends) in enumerate(world.ground_solids()):
        box = {"pos": exact_text(middle), "size": exact_text(0.5 * size)}
        _add(parent, "geom", look | box, name=f"slab_{n}", type="box")
        cylinder = {"fromto": exact_text(np.ravel(ends)), "size": repr(world.unit * EDGE_RADIUS)}
        _add(parent, "geom", look | cylinder, name=f"edge_{n}", type="cylinder")


def _add_robot(parent: ET.Element, world: World, row: int) -> None:
    """Add a free body with its docks and links."""
    turn = world.turn[row].as_quat(scalar_first=True)
    pose = {"pos": exact_text(world.unit * world.center[row]), "quat": exact_text(turn)}
    body = _add(parent, "body", {"name": world.name(row)} | pose)
    _add(body, "freejoint")
    rgba = f"{exact_text(world.color[row])} 1"
    for d, offset in enumerate(world.unit * world.view.dock_offset_body):
        sphere = {"name": f"dock_{world.robots[row]}.{d}", "pos": exact_text(offset)}
        _add(body, "geom", {"class": "dock"} | sphere, size=repr(world.unit), rgba=rgba)
        capsule = {
            "fromto": f"0 0 0 {exact_text(offset)}",
            "size": repr(_LINK_RADIUS * world.unit),
        }
        _add(body, "geom", {"class": "link"} | capsule, rgba=rgba)


# --- Webots ----------------------------------------------------------------------------------

_NO_CONTROLLER = '"<none>"'


def encode_wbt(view: SwarmView) -> dict[str, bytes]:
    """Encode the structure, or the estimate where the truth is unknown, for Webots R2023b.

    A joint is a pair of connectors that are locked from the start. Each pair has a `model` of its
    own, so that no third one fits. Connectors of the ground are those of a robot that does not
    move. No robot has a controller.
    """
    world = build_world(view)
    connectors: dict[int, list[str]] = {row: [] for row in range(_NONE, len(world.robots))}
    for joint in world.joints:
        for row, axis in ((joint.row, joint.axis), (joint.partner, -joint.axis)):
            connectors[row].append(_connector(world, joint, row, axis))
    robots = (_robot(world, row, connectors[row]) for row in range(len(world.robots)))
    nodes = [*_scenery(world), _ground(world, connectors[_NONE]), *robots]
    return {"case.wbt": "\n".join(["#VRML_SIM R2023b utf8", *nodes, ""]).encode()}


def _scenery(world: World) -> Iterator[str]:
    """Write what is neither robot nor ground; the camera looks along y."""
    about = [f"{name}: {exact_text(numbers)}" for name, numbers in world.about.items()]
    info = [_quoted(text) for text in (world.units, *about, f"tiswarm {__version__}")]
    title = _quoted(world.view.name or "case")
    yield _node("WorldInfo", title=title, info=info, gravity=repr(GRAVITY), basicTimeStep="2")
    low = np.min(world.center, axis=0, initial=0.0)
    high = np.max(world.center, axis=0, initial=0.0)
    eye = 0.5 * (low + high) - [0.0, 1.5 * float((high - low).max()) + 15.0, 0.0]
    turned = "0 0 1 1.5707963267948966"
    yield _node("Viewpoint", orientation=turned, position=exact_text(world.unit * eye))
    yield _node("Background", skyColor=["1 1 1"])
    yield _node("DirectionalLight", direction="0.3 0.5 -1", ambientIntensity="0.5")


def _node(kind: str, **fields: str | list[str]) -> str:
    """Write a node; a list is a field of several values."""
    lines = []
    for name, value in fields.items():
        text = value if isinstance(value, str) else "\n".join(["[", *map(_indented, value), "]"])
        lines.append(_indented(f"{name} {text}"))
    return "\n".join([f"{kind} {{", *lines, "}"])


def _indented(text: str) -> str:
    return "  " + text.replace("\n", "\n  ")


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _rotation(turn: Rotation) -> str:
    """Write a rotation as axis and angle."""
    vector = turn.as_rotvec()
    return exact_text([*_unit(vector), float(np.linalg.norm(vector))])


def _pose(place: Reals, child: str, turn: Rotation | None = None) -> str:
    rotation = {} if turn is None else {"rotation": _rotation(turn)}
    return _node("Pose", translation=exact_text(place), **rotation, children=[child])


def _shape(geometry: str, color: Reals) -> str:
    look = _node("PBRAppearance", baseColor=exact_text(color), metalness="0")
    return _node("Shape", appearance=look, geometry=geometry)


def _frame(axis: Reals) -> Rotation:
    """Choose an orientation whose z axis is a unit vector."""
    y = _unit(np.cross(axis, np.eye(3)[np.abs(axis).argmin()]))
    return Rotation.from_matrix(np.column_stack([np.cross(y, axis), y, axis]))


def _connector(world: World, joint: Joint, row: int, axis: Reals) -> str:
    """Write the connector of a joint on a robot, or on the ground, whose z axis is outward."""
    turn = _frame(axis) if row == _NONE else world.turn[row].inv() * _frame(axis)
    name = _quoted(world.joint_name(joint))
    return _node(
        "Connector",
        translation=exact_text(world.in_body(row, joint.place)),
        rotation=_rotation(turn),
        name=name,
        model=name,
        isLocked="TRUE",
        numberOfRotations="0",
        snap="FALSE",
        distanceTolerance=repr(0.1 * world.unit),
    )


def _robot(world: World, row: int, connectors: list[str]) -> str:
    """Write a robot with its docks, links and connectors."""
    sphere = _node("Sphere", radius=repr(world.unit))
    color = world.color[row]
    docks = world.unit * world.view.dock_offset_body
    shapes = [_pose(offset, _shape(sphere, color)) for offset in docks]
    link_radius = repr(_LINK_RADIUS * world.unit)
    for offset in docks:
        height = repr(float(np.linalg.norm(offset)))
        link = _shape(_node("Capsule", height=height, radius=link_radius), color)
        shapes.append(_pose(0.5 * offset, link, _frame(_unit(offset))))
    return _node(
        "Robot",
        translation=exact_text(world.unit * world.center[row]),
        rotation=_rotation(world.turn[row]),
        name=_quoted(world.name(row)),
        children=[*shapes, *connectors],
        controller=_NO_CONTROLLER,
        boundingObject=_node("Group", children=[_pose(offset, sphere) for offset in docks]),
        physics=_node("Physics", density="-1", mass=repr(len(docks) / GRAVITY)),
    )


def _ground(world: World, connectors: list[str]) -> str:
    """Write the ground as a robot without physics, which does not move."""
    solids: list[tuple[Reals, str, Rotation | None]] = []
    if world.plane is not None:
        plane = _node("Plane", size=exact_text([2.0 * _PLANE * world.unit] * 2))
        solids.append((np.array([0.0, 0.0, world.unit * world.plane]), plane, None))
    if world.surface is not None:
        surface = world.surface
        cell = repr(world.unit * surface.cell)
        grid = _node(
            "ElevationGrid", xDimension=str(surface.height.shape[0]),
            yDimension=str(surface.height.shape[1]), xSpacing=cell, ySpacing=cell,
            height=f"[ {exact_text((world.unit * surface.height.T).ravel())} ]",
        )  # fmt: skip
        solids.append((world.unit * np.array([*surface.corner, 0.0]), grid, None))
    radius = repr(world.unit * EDGE_RADIUS)
    for middle, size, start, end in world.ground_solids():
        solids.append((middle, _node("Box", size=exact_text(size)), None))
        height = repr(float(np.linalg.norm(end - start)))
        edge = _node("Cylinder", height=height, radius=radius)
        solids.append((0.5 * (start + end), edge, _frame(_unit(end - start))))
    gray = np.full(3, 0.8)
    shapes = [_pose(place, _shape(solid, gray), turn) for place, solid, turn in solids]
    bounds = [_pose(place, solid, turn) for place, solid, turn in solids]
    bounding = {"boundingObject": _node("Group", children=bounds)} if bounds else {}
    return _node(
        "Robot",
        name=_quoted("ground"),
        children=[*shapes, *connectors],
        **bounding,
        controller=_NO_CONTROLLER,
    )
