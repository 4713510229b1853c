"""Bags of ROS give the poses of robots as messages state them, or a line that says why not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.formats.test_programs import OURS, assert_same, bring_in, written
from tiswarm.base.errors import EnvironmentTroubleError, InputError

pytest.importorskip("rosbags", reason="the extra ros")
layouts = pytest.importorskip("tests.formats.bag_layouts")

OFFSET = np.random.default_rng(0).normal(0.0, 5.0, (8, 3))
"""Origins of the robots' own frames in the world's."""

UNTURNED = Rotation.identity()


@pytest.fixture(scope="module")
def pose(towers):
    """Positions and orientations of the first eight robots of a tower."""
    turn = Rotation.from_quat(towers[0].orientation_wxyz[:8], scalar_first=True)
    return towers[0].position[:8], turn


@pytest.fixture(scope="module")
def plain(pose, tmp_path_factory):
    """The log of the poses under our own names."""
    return bring_in(written(tmp_path_factory.mktemp("plain"), OURS, *pose))


def by_robot(lab, parent="world", child="bot_{}", shift=None):
    """Transforms of each robot in a parent frame whose origin is shifted."""
    origin = np.zeros((8, 3)) if shift is None else shift
    return [
        (parent.format(k), child.format(k), lab.place[k] - origin[k], lab.turn[k])
        for k in lab.robots
    ]


def origins(parent="map", child="bot_{}/odom"):
    """Transforms of the robots' own frames."""
    return [(parent, child.format(k), OFFSET[k], UNTURNED) for k in range(8)]


def odometry(lab, parent="world", child="base"):
    """Odometry of each robot, at all times."""
    shift = OFFSET if "{}" in parent else np.zeros((8, 3))
    for k in lab.robots:
        for time in layouts.TIMES_S:
            place = lab.place[k] - shift[k]
            message = lab.odometry(time, parent.format(k), child.format(k), place, lab.turn[k])
            yield layouts.Sent(time, f"/bot_{k}/odom", "nav_msgs/msg/Odometry", message)


def namespaced(lab):
    """Transforms of each robot on a topic of its own, with frames of the same names."""
    for k in lab.robots:
        chain = [("map", "odom", OFFSET[k], UNTURNED)]
        chain.append(("odom", "base_link", lab.place[k] - OFFSET[k], lab.turn[k]))
        yield from lab.sent_transforms(chain, topic=f"/bot_{k}/tf")


def turned(lab):
    """Poses in the frame of the cameras, which is turned in the world's."""
    quarter = Rotation.from_euler("x", 90.0, degrees=True)
    inner = quarter.inv()
    for k in lab.robots:
        for time in layouts.TIMES_S:
            message = lab.stamped(time, inner.apply(lab.place[k]), inner * lab.turn[k], "mocap")
            yield layouts.Sent(time, f"/bot_{k}/pose", "geometry_msgs/msg/PoseStamped", message)
    static = [("world", "mocap", np.zeros(3), quarter)]
    yield from lab.sent_transforms(static, topic="/tf_static", time_s=1.0)


def two_cameras(lab):
    """Transforms of two cameras, each of which sees half of the robots."""
    seen = by_robot(lab, "camera_1")[:4]
    seen += [
        ("camera_2", child, place - OFFSET[0], turn) for _, child, place, turn in by_robot(lab)[4:]
    ]
    yield from lab.sent_transforms(seen)
    static = [
        ("world", "camera_1", np.zeros(3), UNTURNED),
        ("world", "camera_2", OFFSET[0], UNTURNED),
    ]
    yield from lab.sent_transforms(static, topic="/tf_static", time_s=1.0)


def with_docks(lab, topic):
    """Transforms of robots, and of their docks."""
    docks = [
        (f"bot_{k}", f"bot_{k}/dock_{d}", np.eye(3)[d], UNTURNED)
        for k in lab.robots
        for d in range(3)
    ]
    yield from lab.sent_transforms(by_robot(lab))
    yield from lab.sent_transforms(docks, topic=topic)


def with_lost(lab):
    """Poses beside those of bodies that the cameras lost: zeros, or no numbers."""
    yield from lab.sent_poses()
    kind = "geometry_msgs/msg/PoseStamped"
    lost = lab.stamped(1.05, np.full(3, np.nan), UNTURNED)
    yield layouts.Sent(1.05, "/bot_3/pose", kind, lost)
    zeros = lab.stamped(1.06, np.zeros(3), UNTURNED)
    zeros.pose.orientation.w = 0.0
    yield layouts.Sent(1.06, "/bot_4/pose", kind, zeros)


def paths(lab):
    """The path of each robot."""
    for k in lab.robots:
        steps = [lab.stamped(1.2, lab.place[k] + [0, 0, j], lab.turn[k]) for j in range(3)]
        message = lab.made("nav_msgs/msg/Path", header=lab.header(1.2), poses=steps)
        yield layouts.Sent(1.2, f"/bot_{k}/path", "nav_msgs/msg/Path", message)


READ = {
    "pose of each robot": lambda lab: lab.sent_poses(),
    "odometry in the world": odometry,
    "odometry in frames of their own": lambda lab: [
        *odometry(lab, "bot_{}/odom", "bot_{}/base_link"),
        *lab.sent_transforms(origins(), topic="/tf_static", time_s=1.0),
    ],
    "tree of frames": lambda lab: lab.sent_transforms(
        [*origins(), *by_robot(lab, "bot_{}/odom", "bot_{}/base_link", OFFSET)]
    ),
    "tree and odometry of the same frames": lambda lab: [
        *lab.sent_transforms([*origins(), *by_robot(lab, "bot_{}/odom", "bot_{}/body", OFFSET)]),
        *odometry(lab, "bot_{}/odom", "bot_{}/body"),
    ],
    "tree in the namespace of each robot": namespaced,
    "turned frame of motion capture": turned,
    "two cameras": two_cameras,
    "static docks": lambda lab: with_docks(lab, "/tf_static"),
    "docks sent again and again": lambda lab: with_docks(lab, "/tf"),
    "goals beside poses": lambda lab: [
        *lab.sent_poses(), *lab.sent_poses("/bot_{}/goal_pose", lift=3.0)
    ],
    "paths beside poses": lambda lab: [*lab.sent_poses(), *paths(lab)],
    "names in another order": lambda lab: lab.sent_names([*lab.robots][::-1]),
    "names, one lost at the end": lambda lab: lab.sent_names(lab.robots, lacking=[4]),
    "names beside transforms of the same": lambda lab: [
        *lab.sent_names(lab.robots), *lab.sent_transforms(by_robot(lab, child="cf{}"))
    ],
    "list without names": lambda lab: lab.sent_list(),
    "models of a simulator": lambda lab: lab.sent_models(),
    "models beside the ground": lambda lab: lab.sent_models(["ground_plane", "sun"]),
    "lost bodies": with_lost,
    "names of letters": lambda lab: lab.sent_poses("/vrpn/{}/pose", names=layouts.LETTERS),
}  # fmt: skip
"""Layouts that state all, by what is special in them."""


@pytest.mark.parametrize("name", READ)
def test_a_layout_of_a_laboratory_is_read(name, pose, plain, tmp_path):
    """Names, frames and times come from the messages; nothing else counts for a robot."""
    lab = layouts.Laboratory(*pose)

    swarm = bring_in(lab.record(tmp_path, READ[name](lab)))

    assert_same(swarm, plain)
    assert swarm.log.length_unit == "m"
    assert swarm.warnings == []


@pytest.mark.parametrize("name", ["odometry in the world", "list without names"])
def test_a_bag_of_the_first_ros_is_read(name, pose, plain, tmp_path):
    """ROS 1 has other heads and another file."""
    lab = layouts.Laboratory(*pose, ros=1)

    swarm = bring_in(lab.record(tmp_path, READ[name](lab)))

    assert_same(swarm, plain)


def two_systems(lab):
    """Poses of each robot by two systems."""
    return [*lab.sent_poses("/mocap/bot_{}/pose"), *lab.sent_poses("/eyes/bot_{}/pose")]


REFUSED = {
    "two systems": (
        two_systems,
        r"there are several sources of poses: /mocap/bot_\*/pose .*, /eyes/bot_.*; choose one by",
    ),
    "two types": (
        lambda lab: [*lab.sent_poses(), *odometry(lab, "bot_{}/odom", "bot_{}/base")],
        r"there are several sources of poses: .*/bot_\*/odom \(Odometry; .*; choose one by --topic",
    ),
    "frames apart": (
        lambda lab: odometry(lab, "bot_{}/odom", "bot_{}/base"),
        r"no transform joins the frames of poses: .*bot_0/odom.*; record /tf and /tf_static",
    ),
    "paths alone": (paths, "the bag has no poses of robots; record odometry, poses or tf"),
    "goals alone": (
        lambda lab: lab.sent_poses("/bot_{}/goal_pose"),
        r".* no poses of robots; .*, or choose --topic of /bot_\*/goal_pose",
    ),
    "a list that changes": (
        lambda lab: lab.sent_list(lacking=[4]),
        "the lists of /swarm have 8 poses and 7, and no names: .*; record names, or a topic",
    ),
    "models of two kinds": (
        lambda lab: lab.sent_models(["wall_1", "wall_2"]),
        r"bodies are of several kinds, bot_\*, wall_\*; .* --bodies 'bot_\*'",
    ),
    "a circle of frames": (
        lambda lab: [
            *lab.sent_poses(frame="a"),
            *lab.sent_transforms(
                [("a", "b", np.ones(3), UNTURNED), ("b", "a", np.ones(3), UNTURNED)]
            ),
        ],
        "the frame [ab] is above itself; record transforms that form a tree",
    ),
}
"""Layouts that do not state all, by what they lack, and the lines."""


@pytest.mark.parametrize("name", REFUSED)
def test_a_layout_that_leaves_a_choice_is_refused(name, pose, tmp_path):
    """A line names the choices, and how to make one; nothing is guessed."""
    lab = layouts.Laboratory(*pose)
    messages, line = REFUSED[name]

    with pytest.raises(InputError, match=rf"run: {line}"):
        bring_in(lab.record(tmp_path, messages(lab)))


@pytest.mark.parametrize(
    ("name", "choice"),
    [
        ("two systems", {"topic": "/eyes/*"}),
        ("two types", {"topic": "/bot_*/pose"}),
        ("goals alone", {"topic": "/bot_*/goal_pose"}),
        ("models of two kinds", {"bodies": "bot_*"}),
    ],
)
def test_a_choice_of_the_user_is_followed(name, choice, pose, plain, tmp_path):
    """A pattern chooses topics, or bodies."""
    lab = layouts.Laboratory(*pose)
    messages, _ = REFUSED[name]

    swarm = bring_in(lab.record(tmp_path, messages(lab)), **choice)

    assert_same(swarm, plain)


@pytest.mark.parametrize("argument", ["topic", "bodies"])
def test_a_choice_that_nothing_matches_is_refused(argument, pose, tmp_path):
    """The line lists what there is; a table has neither topics nor bodies."""
    lab = layouts.Laboratory(*pose)
    bag = lab.record(tmp_path, lab.sent_poses())
    table = written(tmp_path, OURS, *pose)

    with pytest.raises(InputError, match=rf"run: {argument}: no .* is 'none\*'; .*bot_"):
        bring_in(bag, **{argument: "none*"})
    with pytest.raises(InputError, match=f"{argument}: only bags of ROS have topics and bodies"):
        bring_in(table, **{argument: "none*"})


def test_stamps_count_where_a_robot_was_recorded_late(pose, tmp_path):
    """The join order is that of the stamps, and a note names the robot that was late."""
    lab = layouts.Laboratory(*pose)
    walks = [
        layouts.Sent(
            float(k + step), f"/bot_{k}/pose", "geometry_msgs/msg/PoseStamped",
            lab.stamped(float(k + step), lab.place[k] + [0.0, 0.0, 3.0 * (step < 2)], lab.turn[k]),
        )
        for k in lab.robots
        for step in range(1, 9)
    ]  # fmt: skip
    late = [sent._replace(time_s=sent.time_s + 60.0 * ("_3" in sent.topic)) for sent in walks]

    on_time = bring_in(lab.record(tmp_path / "a", walks))
    delayed = bring_in(lab.record(tmp_path / "b", late))

    np.testing.assert_array_equal(delayed.log.robot_id, on_time.log.robot_id)
    assert [note for note in delayed.notes if "recorded up to 60 s apart" in note]
    assert not [note for note in on_time.notes if "apart" in note]


def test_damaged_bags_never_escape(pose, tmp_path, monkeypatch):
    """A line says what to do, without the library too."""
    lab = layouts.Laboratory(*pose, ros=1)
    path = lab.record(tmp_path, lab.sent_poses())
    path.write_bytes(path.read_bytes()[:300])

    with pytest.raises(InputError, match=r"run.bag: not a whole bag \(\w+: .*; record it again"):
        bring_in(path)
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(EnvironmentTroubleError, match=r"pip install 'tiswarm\[ros\]'"):
        bring_in(path)


@pytest.mark.parametrize("part", ["file", "folder"])
def test_parts_of_a_bag_are_named(part, pose, tmp_path):
    """A database alone, or a folder without its metadata, says how to make the bag whole."""
    lab = layouts.Laboratory(*pose)
    folder = lab.record(tmp_path, lab.sent_poses())
    (folder / "metadata.yaml").unlink()
    path = next(folder.glob("*.db3")) if part == "file" else folder

    with pytest.raises(InputError, match=r"a .*bag of ROS 2.*; .*ros2 bag reindex"):
        bring_in(path)
