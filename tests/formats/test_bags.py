"""Bags of ROS 1 and ROS 2 give the poses that their messages have."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.formats.test_programs import OURS, assert_same, bring_in, written
from tiswarm.base.errors import EnvironmentTroubleError, InputError

rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="the extra ros")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

GEOMETRY = "geometry_msgs/msg/"


@pytest.fixture(scope="module")
def pose(towers):
    """Positions and orientations of the first eight robots of a tower."""
    turn = Rotation.from_quat(towers[0].orientation_wxyz[:8], scalar_first=True)
    return towers[0].position[:8], turn


@pytest.fixture(scope="module")
def plain(pose, tmp_path_factory):
    """The log of the poses under our own names."""
    return bring_in(written(tmp_path_factory.mktemp("plain"), OURS, *pose))


def header(types, ros, frame="map"):
    """Head of a message."""
    seq = {"seq": 0} if ros == 1 else {}
    time = types["builtin_interfaces/msg/Time"](sec=1, nanosec=0)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **seq)


def posed(types, place, turn):
    """A pose."""
    x, y, z, w = turn.as_quat().tolist()
    point = types[f"{GEOMETRY}Point"](*place.tolist())
    quaternion = types[f"{GEOMETRY}Quaternion"](x=x, y=y, z=z, w=w)
    return types[f"{GEOMETRY}Pose"](position=point, orientation=quaternion)


def odometry(types, ros, place, turn):
    """By topic and type, odometry of each robot."""
    vector = types[f"{GEOMETRY}Vector3"](x=9.0, y=9.0, z=9.0)
    twist = types[f"{GEOMETRY}Twist"](linear=vector, angular=vector)
    for k in range(len(place)):
        message = types["nav_msgs/msg/Odometry"](
            header=header(types, ros), child_frame_id="base",
            pose=types[f"{GEOMETRY}PoseWithCovariance"](
                pose=posed(types, place[k], turn[k]), covariance=np.zeros(36)),
            twist=types[f"{GEOMETRY}TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
        )  # fmt: skip
        yield f"/bot_{k}/odom", "nav_msgs/msg/Odometry", message


def transforms(types, ros, place, turn):
    """All robots in one message of frames."""
    found = []
    for k in range(len(place)):
        x, y, z, w = turn[k].as_quat().tolist()
        moved = types[f"{GEOMETRY}Transform"](
            translation=types[f"{GEOMETRY}Vector3"](*place[k].tolist()),
            rotation=types[f"{GEOMETRY}Quaternion"](x=x, y=y, z=z, w=w),
        )
        found.append(
            types[f"{GEOMETRY}TransformStamped"](
                header=header(types, ros), child_frame_id=f"bot_{k}", transform=moved
            )
        )
    yield "/tf", "tf2_msgs/msg/TFMessage", types["tf2_msgs/msg/TFMessage"](transforms=found)


def listed(types, ros, place, turn):
    """All robots in a list of poses."""
    poses = [posed(types, p, t) for p, t in zip(place, turn, strict=True)]
    kind = f"{GEOMETRY}PoseArray"
    yield "/swarm", kind, types[kind](header=header(types, ros), poses=poses)


def recorded(folder, ros, messages, pose):
    """Write a bag; returns its path."""
    store = typesys.get_typestore(
        typesys.Stores.ROS1_NOETIC if ros == 1 else typesys.Stores.ROS2_HUMBLE
    )
    path = folder / ("run.bag" if ros == 1 else "run")
    bag = rosbag1.Writer(path) if ros == 1 else rosbag2.Writer(path, version=9)
    with bag:
        for topic, kind, message in messages(store.types, ros, *pose):
            connection = bag.add_connection(topic, kind, typestore=store)
            write = store.serialize_ros1 if ros == 1 else store.serialize_cdr
            bag.write(connection, 10**9, write(message, kind))
    return path


@pytest.mark.parametrize("messages", [odometry, transforms, listed])
@pytest.mark.parametrize("ros", [1, 2])
def test_the_poses_of_a_bag_are_read(ros, messages, pose, plain, tmp_path):
    """The structure is that of a table; speeds beside poses count for nothing."""
    if ros == 1 and messages is transforms:
        pytest.skip("the library has no such type of ROS 1")

    found = bring_in(recorded(tmp_path, ros, messages, pose))

    assert_same(found, plain)
    assert found.log.length_unit == "m"


def test_damaged_bags_never_escape(pose, tmp_path, monkeypatch):
    """A line says what to do, without the library too."""
    path = recorded(tmp_path, 1, odometry, pose)
    path.write_bytes(path.read_bytes()[:300])

    with pytest.raises(InputError, match=r"run.bag: not a whole bag \(\w+: .*; record it again"):
        bring_in(path)
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(EnvironmentTroubleError, match=r"pip install 'tiswarm\[ros\]'"):
        bring_in(path)
