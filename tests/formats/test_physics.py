"""Structures stand in MuJoCo as in the mechanics, and files for Webots follow its grammar."""

import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests import frames
from tests.runs import REPOSITORY
from tiswarm.base.robot import RobotGeometry
from tiswarm.formats.physics import NOMINAL_RADIUS, encode_mjcf, encode_wbt
from tiswarm.scenario.expansion import load_scenario
from tiswarm.world.ground.surface import shown_ground
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import BridgeParams, CantileverParams, DepartureParams, TowerParams


def _grown(params: TowerParams | CantileverParams | BridgeParams, robots: int = 20) -> History:
    return grow(params, robots=robots, seeds=[0], robot=RobotGeometry())[0]


@pytest.fixture(scope="module")
def histories(towers):
    """Structures on a plane, beyond an edge and on both sides, and of robots of four docks."""
    square = RobotGeometry(shape="square", rho=1.8)
    return [
        towers[0],
        _grown(CantileverParams()),
        _grown(BridgeParams(), 40),
        grow(TowerParams(), robots=10, seeds=[0], robot=square)[0],
    ]


@pytest.fixture
def simulation():
    """The class that loads a file into MuJoCo; the test is skipped where that is missing."""
    pytest.importorskip("mujoco", reason="the developers' tools have it from Python 3.11 on")
    from tests.oracle_mujoco import Simulation  # noqa: PLC0415 - an import that may be missing

    return Simulation


def _elements(xml: bytes, tag: str) -> list[ET.Element]:
    return [*ET.fromstring(xml).iter(tag)]  # noqa: S314 - ours


def _welds(xml: bytes) -> set[str]:
    return {weld.get("name") for weld in _elements(xml, "weld")}


def test_joints_are_the_contacts_of_the_mechanics(histories):
    """Docks and feet, those on rounded edges too."""
    for history in histories:
        (xml,) = encode_mjcf(frames.view_of(history)).values()

        assert _welds(xml) == frames.joint_names(frames.grown(history))


def test_joints_are_where_docks_meet(histories, simulation):
    """Halfway between two docks, and at the foot of a dock on the ground."""
    for history in histories:
        structure = frames.grown(history)
        docks = len(structure.body)
        (xml,) = encode_mjcf(frames.view_of(history)).values()
        world = simulation(xml)
        foot = dict(zip(structure.standing.tolist(), structure.foot, strict=True))

        for weld in world.welds:
            own = [docks * robot + dock for robot, dock in weld.ends]
            expected = structure.dock[own].mean(axis=0) if len(own) > 1 else foot[own[0]]
            expected = NOMINAL_RADIUS * (expected - structure.center[0])
            np.testing.assert_allclose(weld.place, expected, rtol=0.0, atol=1e-9)


def test_a_true_structure_has_its_true_contacts(towers):
    """Contacts that a log misses are found, and those that it invents are left out."""
    history = towers[0]
    view = frames.view_of(
        history, missed_contacts=0.3, false_contacts=0.3, wrong_docks=0.1, compass=True
    )
    assert {*map(tuple, view.log.contacts.tolist())} != {*map(tuple, history.contacts.tolist())}

    (xml,) = encode_mjcf(view).values()

    assert _welds(xml) == frames.joint_names(frames.grown(history))


def test_an_estimate_has_the_contacts_of_its_log(towers):
    """Robots without an estimate and those that left are left out, with their contacts."""
    view = frames.view_of(towers[0])
    pose = view.estimated_pose.copy()
    pose[:, 0] += 0.3
    pose[7] = np.nan
    log = replace(view.log, gone=np.array([9]))
    some = replace(view, pose=np.full_like(pose, np.nan), estimated_pose=pose, read_log=lambda: log)

    (xml,) = encode_mjcf(some).values()

    out = re.compile(r"(?:contact|foot)_(?:.*_)?[79]\.")
    expected = frames.joint_names(frames.grown(towers[0]))
    assert _welds(xml) == {name for name in expected if not out.match(name)}
    bodies = [body.get("name") for body in _elements(xml, "body")]
    assert bodies == [f"robot_{i}" for i in range(30) if i not in {7, 9}]


def test_an_estimate_stands_as_it_is(towers, simulation):
    """Docks that overlap or are apart by errors of 0.3 R stay where the estimate puts them."""
    view = frames.view_of(towers[0])
    pose = view.estimated_pose.copy()
    pose[1:, :3] += np.random.default_rng(0).normal(0.0, 0.3, (29, 3))
    (xml,) = encode_mjcf(
        replace(view, pose=np.full_like(pose, np.nan), estimated_pose=pose)
    ).values()
    world = simulation(xml)

    world.run(2.0)

    assert world.data.ncon == 0
    assert world.moved < 0.01
    apart = {frozenset(e.get(key) for key in ("body1", "body2")) for e in _elements(xml, "exclude")}
    welds = [{e.get("body1"), e.get("body2", "world")} for e in _elements(xml, "weld")]
    assert {frozenset(pair) for pair in welds} <= apart


def test_without_ground_anchors_are_fixed(towers, simulation):
    """Nothing else holds modules in space."""
    (xml,) = encode_mjcf(frames.view_of(towers[0], ground_docks=False)).values()

    assert {name for name in _welds(xml) if "contact" not in name} == {"anchor_0"}
    assert b"plane" not in xml


@pytest.mark.parametrize(("unit", "meters"), [("cm", 0.01), ("R", NOMINAL_RADIUS), ("pixel", None)])
def test_lengths_are_in_meters(towers, unit, meters):
    """Units of length are converted; others get a nominal scale, and the file says so."""
    view = frames.view_of(towers[0])
    log = replace(view.log, length_unit=unit)

    (xml,) = encode_mjcf(replace(view, read_log=lambda: log)).values()

    root = ET.fromstring(xml)  # noqa: S314 - ours
    radius = float(root.find("custom/numeric[@name='R']").get("data"))
    assert radius == pytest.approx(meters or NOMINAL_RADIUS)
    assert (b"nominal scale" in xml) == (unit != "cm")
    body = root.find("worldbody/body[@name='robot_5']")
    place = np.array(body.get("pos").split(), float)
    np.testing.assert_allclose(
        place, radius * (towers[0].position[5] - towers[0].position[0]), atol=1e-12
    )
    dock = body.find("geom[@name='dock_5.0']")
    assert float(dock.get("size")) == radius


def _hold(simulation, history):
    """Simulate a structure for two seconds, and check that it stands."""
    (xml,) = encode_mjcf(frames.view_of(history)).values()
    world = simulation(xml)

    world.run(2.0)

    weight = float(history.robot.dock_count * history.robot_count)
    assert world.data.ncon == 0  # what touches is welded, and nothing else comes to touch
    # Towers of 100 sag by 0.0004 R; cantilevers, which bend more, by 0.004 R at most.
    assert world.moved < 0.01
    # At rest, what moves on adds up to the residual: mass times acceleration, some 1e-9.
    assert np.abs(world.data.qvel).max() < 1e-9
    np.testing.assert_allclose(world.ground_force, [0.0, 0.0, weight], atol=1e-6 * weight)


def test_structures_stand_in_mujoco(histories, simulation):
    """Positions hold for two seconds, and the ground bears the weight."""
    for history in histories:
        _hold(simulation, history)


def test_robots_that_left_are_not_in_the_world(simulation):
    """A tower that a third of its robots left stands without them."""
    params = TowerParams(departures=DepartureParams(rate=0.3))
    history = _grown(params, 30)
    stay = ~history.is_gone
    assert 3 < stay.sum() < 30
    view = frames.view_of(history)
    log = replace(view.log, gone=np.flatnonzero(history.is_gone))
    (xml,) = encode_mjcf(replace(view, read_log=lambda: log)).values()

    world = simulation(xml)
    world.settle()

    bodies = [world.model.body(i).name for i in range(1, world.model.nbody)]
    assert bodies == [f"robot_{i}" for i in np.flatnonzero(stay).tolist()]
    joints = {
        f"contact_{i}.{a}_{j}.{b}" for i, a, j, b in history.contacts.tolist() if stay[[i, j]].all()
    }
    joints |= {f"foot_{i}.{d}" for i, d in history.ground_docks.tolist() if stay[i]}
    assert _welds(xml) == joints
    assert world.moved < 0.01
    np.testing.assert_allclose(world.ground_force, [0.0, 0.0, 3.0 * stay.sum()], atol=1e-6)


@pytest.mark.trial
@pytest.mark.parametrize("params", [TowerParams(), CantileverParams(), BridgeParams()])
def test_structures_of_100_stand_in_mujoco(params, simulation):
    """A tower, a cantilever and a bridge of 100 robots, or as many as it needs to cross."""
    _hold(simulation, _grown(params, 100))


def test_the_ground_is_where_docks_stand(histories, simulation):
    """The solids of the ground touch all feet, up to the gap of a contact, and no other dock."""
    mujoco = pytest.importorskip("mujoco")
    for history in histories:
        (xml,) = encode_mjcf(frames.view_of(history)).values()
        world = simulation(xml)
        solids = [g for g in range(world.model.ngeom) if world.model.geom_bodyid[g] == 0]
        standing = {*frames.grown(history).standing.tolist()}

        docks = history.robot.dock_count
        for dock in range(docks * history.robot_count):
            sphere = world.model.geom("dock_{}.{}".format(*divmod(dock, docks))).id
            gap = min(
                mujoco.mj_geomDistance(world.model, world.data, sphere, solid, 1.0, None)
                for solid in solids
            )
            # Boxes touch spheres within 1e-6 of their size, by MuJoCo's own solver.
            if dock in standing:
                assert -1e-4 < gap / world.radius < 0.0201
            else:
                assert gap / world.radius > 0.0199


def _same_loads(actual, expected, tolerance):
    for one, other in zip(actual, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=tolerance * other.max())


def test_without_loops_all_agree(histories, simulation):
    """Statics alone decides: no stiffness matters, neither ours nor that of welds."""
    for history in histories:
        structure = frames.tree(frames.grown(history))
        expected = frames.link_loads(structure)
        _same_loads(frames.link_loads(structure, model="rigid"), expected, 1e-9)
        (xml,) = encode_mjcf(frames.view_of(history)).values()
        # Robots sag by up to 0.01 R on arms of 3 R, and a hundredth of that at less gravity.
        for gravity, tolerance in ((1.0, 3e-3), (0.01, 3e-5)):
            world = simulation(xml, frames.joint_names(structure), gravity)

            world.settle()

            _same_loads(world.loads(structure), expected, tolerance)


def test_with_loops_welds_are_springs(histories, simulation):
    """Rigid robots on springs of MuJoCo's stiffness bear what they bear in MuJoCo.

    What differs is how far robots sag, which is in proportion to gravity.
    """
    for history in histories:
        structure = frames.grown(history)
        (xml,) = encode_mjcf(frames.view_of(history)).values()
        for gravity, tolerance in ((1.0, 1e-3), (0.01, 1e-5)):
            world = simulation(xml, gravity=gravity)
            springs = world.springs(structure)

            world.settle()

            loads = world.loads(structure)
            _same_loads(loads, springs, tolerance)
        # The stiffness of beams gives other loads, of the same size.
        rigid = frames.link_loads(structure, model="rigid")
        for one, other in zip(loads, rigid, strict=True):
            assert np.corrcoef(one.mean(axis=1), other.mean(axis=1))[0, 1] > 0.8
            assert np.abs(one - other).max() > 0.03 * other.max()


FIELDS = {
    "WorldInfo": {"title": str, "info": [str], "gravity": 1, "basicTimeStep": 1},
    "Viewpoint": {"orientation": 4, "position": 3},
    "Background": {"skyColor": [3]},
    "DirectionalLight": {"direction": 3, "ambientIntensity": 1},
    "Robot": {
        "translation": 3, "rotation": 4, "children": [dict], "name": str, "controller": str,
        "boundingObject": dict, "physics": dict,
    },
    "Pose": {"translation": 3, "rotation": 4, "children": [dict]},
    "Group": {"children": [dict]},
    "Shape": {"appearance": dict, "geometry": dict},
    "PBRAppearance": {"baseColor": 3, "metalness": 1},
    "Sphere": {"radius": 1},
    "Capsule": {"height": 1, "radius": 1},
    "Cylinder": {"height": 1, "radius": 1},
    "Box": {"size": 3},
    "Plane": {"size": 2},
    "Physics": {"density": 1, "mass": 1},
    "Connector": {
        "translation": 3, "rotation": 4, "name": str, "model": str, "isLocked": bool,
        "numberOfRotations": 1, "snap": bool, "distanceTolerance": 1,
    },
}  # fmt: skip
"""Fields of the nodes of Webots R2023b that files have, as its reference manual types them: a
number of numbers, text, truth value or node, or a list of them."""

_TOKEN = re.compile(r'\s*(?:#.*|("(?:[^"\\]|\\.)*")|([{}\[\]])|([^\s{}\[\]"#]+))')


class Reader:
    """Reads the nodes of a file for Webots; refuses what grammar and fields do not allow."""

    def __init__(self, text: str):
        """Split a file into tokens."""
        header, _, body = text.partition("\n")
        assert header == "#VRML_SIM R2023b utf8"
        self.tokens = [next(filter(None, m.groups()), "") for m in _TOKEN.finditer(body)]
        self.tokens = [token for token in self.tokens if token]
        self.at = 0

    def nodes(self) -> list[dict]:
        """Read all nodes."""
        found = []
        while self.at < len(self.tokens):
            found.append(self._node())
        return found

    def _next(self) -> str:
        self.at += 1
        return self.tokens[self.at - 1]

    def _node(self) -> dict:
        kind = self._next()
        assert self._next() == "{", kind
        node = {"kind": kind}
        while self.tokens[self.at] != "}":
            name = self._next()
            assert name not in node, name
            node[name] = self._value(FIELDS[kind][name])
        self.at += 1
        return node

    def _value(self, form):
        if isinstance(form, list):
            assert self._next() == "["
            values = []
            while self.tokens[self.at] != "]":
                values.append(self._value(form[0]))
            self.at += 1
            return values
        if form is dict:
            return self._node()
        if form is str:
            token = self._next()
            assert token[0] == token[-1] == '"'
            return re.sub(r"\\(.)", r"\1", token[1:-1])
        if form is bool:
            return {"TRUE": True, "FALSE": False}[self._next()]
        return np.array([float(self._next()) for _ in range(form)])


def _turn(node) -> Rotation:
    *axis, angle = node.get("rotation", np.array([0.0, 0.0, 1.0, 0.0]))
    assert np.linalg.norm(axis) == pytest.approx(1.0)
    return Rotation.from_rotvec(angle * np.array(axis))


def test_webots_files_have_the_robots_and_their_contacts(histories):
    """Locked connectors of the same model meet in pairs, face to face; each dock weighs 1 N."""
    for history in histories:
        (text,) = encode_wbt(frames.view_of(history)).values()
        nodes = Reader(text.decode()).nodes()

        ground, *robots = [node for node in nodes if node["kind"] == "Robot"]
        assert [node["name"] for node in robots] == [
            f"robot_{i}" for i in range(history.robot_count)
        ]
        origin = history.position[0]
        connectors = {}
        for i, node in enumerate((ground, *robots)):
            place, turn = node.get("translation", np.zeros(3)), _turn(node)
            if i:
                expected = history.orientation_wxyz[i - 1]
                expected = Rotation.from_quat(expected, scalar_first=True)
                assert (turn * expected.inv()).magnitude() < 1e-6
                center = NOMINAL_RADIUS * (history.position[i - 1] - origin)
                np.testing.assert_allclose(place, center, atol=1e-12)
                docks = history.robot.dock_count
                assert 9.81 * node["physics"]["mass"] == pytest.approx(docks)
                assert len(node["boundingObject"]["children"]) == docks
            for each in node["children"]:
                if each["kind"] == "Connector":
                    assert each["isLocked"]
                    frame = turn * _turn(each)
                    end = place + turn.apply(each["translation"]), frame.as_matrix()[:, 2]
                    connectors.setdefault(each["model"], []).append(end)
        assert {*connectors} == frames.joint_names(frames.grown(history))
        for (one, out), (other, back) in connectors.values():
            np.testing.assert_allclose(one, other, atol=1e-12)
            np.testing.assert_allclose(out, -back, atol=1e-7)


def test_a_name_with_quotes_is_quoted(towers):
    """Names of logs are those of files of users."""
    view = replace(frames.view_of(towers[0]), name='a "tall" \\ <tower> & more')

    (text,) = encode_wbt(view).values()
    (xml,) = encode_mjcf(view).values()

    assert Reader(text.decode()).nodes()[0]["title"] == view.name
    assert ET.fromstring(xml).get("model") == view.name  # noqa: S314 - ours


def test_welds_become_ball_joints(towers, simulation):
    """The exchange that the page of files states: the same places, and no moments."""
    (xml,) = encode_mjcf(frames.view_of(towers[0])).values()
    root = ET.fromstring(xml)  # noqa: S314 - ours
    for weld in root.iter("weld"):
        weld.tag = "connect"
        first, second = weld.get("body1"), weld.get("body2", "world")
        weld.set("body1", second)
        weld.set("body2", first)

    balls = simulation(ET.tostring(root))

    joints = zip(simulation(xml).welds, balls.welds, strict=True)
    assert all(np.allclose(weld.place, ball.place, atol=1e-12) for weld, ball in joints)
    assert balls.data.nefc == 3 * balls.model.neq
    assert np.abs(balls.data.efc_pos).max() < 1e-12


@pytest.mark.trial
def test_the_guide_loads_a_tower_into_mujoco(tmp_path, monkeypatch):
    """The blocks of the page run as they are, and the ground bears 300 N."""
    pytest.importorskip("mujoco", reason="the developers' tools have it from Python 3.11 on")
    text = (REPOSITORY / "docs" / "guides" / "physics.md").read_text()
    monkeypatch.chdir(tmp_path)
    names = {}

    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(block, names)  # noqa: S102 - ours

    np.testing.assert_allclose(names["ground"], [0.0, 0.0, 300.0], atol=1e-6)
    assert names["data"].time == pytest.approx(2.0)


@pytest.fixture(scope="module")
def uneven():
    """A structure on a hill with a hole in the plane around it, and its view."""
    hill = [
        {"kind": "slab", "position": [12.0, 0.0, 0.0]},
        {"kind": "sphere", "position": [0.0, 0.0, -40.0], "radius": 45.0},
    ]
    section = {"kind": "tower", "terrain": hill}
    given = {"name": "hill", "structure": section, "localization": {"method": "joint"}}
    history = _grown(load_scenario(given).structure, 6)
    return history, replace(frames.view_of(history), terrain=shown_ground(history))


def _places(surface, margin):
    """Draw places inside a surface, seen from above."""
    rng = np.random.default_rng(2)
    return rng.uniform(surface.corner + margin, surface.end - margin, (60, 2))


def test_the_surface_of_uneven_ground_is_where_the_ground_is(uneven):
    """Each height is the highest point of the ground below it, and feet are on it."""
    history, view = uneven
    surface = view.terrain
    i, j = np.meshgrid(*(np.arange(n) for n in surface.height.shape), indexing="ij")
    x, y = surface.corner[:, None, None] + surface.cell * np.array([i, j])
    point = np.stack([x, y, surface.height], axis=-1).reshape(-1, 3)

    distance = history.terrain.distance(point)

    has_ground = point[:, 2] > surface.height.min() + 1e-9
    assert np.abs(distance[has_ground]).max() < 1e-6
    assert has_ground.mean() > 0.5
    assert np.abs(history.terrain.distance(surface.foot)).max() < 1e-6
    assert len(surface.foot) == len(history.edge_docks) > 0


def test_mujoco_has_the_heights_of_uneven_ground(uneven, simulation):
    """Rays from above meet the field where the surface is, in the frame of the anchor."""
    mujoco = pytest.importorskip("mujoco")
    history, view = uneven
    (xml,) = encode_mjcf(view).values()
    world = simulation(xml)
    unit = world.radius
    surface = view.terrain
    places = _places(surface, 1.0)
    anchor = history.position[0]
    group = np.zeros(6, np.uint8)
    ground = world.model.geom("ground").id
    group[world.model.geom_group[ground]] = 1

    heights = []
    for place in places:
        start = unit * (np.array([*place, 200.0]) - anchor)
        met = np.array([-1], np.int32)
        way = np.array([0.0, 0.0, -1.0])
        length = mujoco.mj_ray(world.model, world.data, start, way, None, 1, -1, met)
        while met[0] >= 0 and met[0] != ground:  # a dock above the ground
            start = start + (length + 1e-9) * way
            length = mujoco.mj_ray(world.model, world.data, start, way, None, 1, -1, met)
        heights.append((start[2] - length) / unit + anchor[2] if met[0] == ground else np.nan)

    # Within a cell MuJoCo has two triangles, and the surface is bilinear: they differ at edges.
    is_close = np.abs(np.array(heights) - surface.height_at(places)) < 0.05
    assert is_close.mean() > 0.8


def test_webots_has_the_heights_of_uneven_ground(uneven):
    """An elevation grid, in rows along x from the least y on."""
    history, view = uneven
    surface = view.terrain
    (text,) = encode_wbt(view).values()

    grids = re.findall(r"ElevationGrid \{(.*?)\}", text.decode(), re.DOTALL)

    expected = (surface.height - history.position[0, 2]).T.ravel()
    assert len(grids) == 2  # what is shown, and what collides
    for grid in grids:
        numbers = re.search(r"height \[ (.*?) \]", grid, re.DOTALL)
        assert numbers is not None
        height = np.array(numbers[1].replace(",", " ").split(), float)
        assert re.search(rf"xDimension {surface.height.shape[0]}\b", grid)
        np.testing.assert_allclose(height / NOMINAL_RADIUS, expected, atol=1e-6)
