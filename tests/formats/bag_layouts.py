"""Bags of one swarm in the layouts of many laboratories: topics, types, names and frames differ."""

from typing import NamedTuple

import numpy as np
from rosbags import rosbag1, rosbag2, typesys
from scipy.spatial.transform import Rotation

GEOMETRY = "geometry_msgs/msg/"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
NAMED = "motion_capture_tracking_interfaces/msg/NamedPose"
MODELS = "gazebo_msgs/msg/ModelStates"
TIMES_S = (1.0, 1.1, 1.2)
LETTERS = ("alpha", "bravo", "charlie", "delta", "echo", "fox", "golf", "hotel")

CUSTOM = {
    NAMED: "string name\ngeometry_msgs/Pose pose\n",
    f"{NAMED}Array": f"std_msgs/Header header\n{NAMED}[] poses\n",
    MODELS: "string[] name\ngeometry_msgs/Pose[] pose\ngeometry_msgs/Twist[] twist\n",
}
"""Types that the library lacks, by their definitions."""


class Sent(NamedTuple):
    """A message, when and where it was recorded."""

    time_s: float
    topic: str
    kind: str
    message: object


class Laboratory:
    """Makes the messages of a swarm of N robots that rest at known poses."""

    def __init__(self, place, turn, ros=2):
        """Take positions, (N, 3), and orientations of the robots, in the frame of the world."""
        noetic = typesys.Stores.ROS1_NOETIC
        self.ros = ros
        self.store = typesys.get_typestore(noetic if ros == 1 else typesys.Stores.ROS2_HUMBLE)
        for name, definition in CUSTOM.items():
            self.store.register(typesys.get_types_from_msg(definition, name))
        self.place = place
        self.turn = turn
        self.robots = range(len(place))

    def made(self, kind, *values, **fields):
        """Make a message."""
        return self.store.types[kind](*values, **fields)

    def header(self, time_s, frame="world"):
        """Head of a message."""
        seq = {"seq": 0} if self.ros == 1 else {}
        nanosec = round(time_s % 1.0 * 1e9)
        stamp = self.made("builtin_interfaces/msg/Time", sec=int(time_s), nanosec=nanosec)
        return self.made("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **seq)

    def pose(self, place, turn):
        """A pose."""
        x, y, z, w = turn.as_quat().tolist()
        point = self.made(f"{GEOMETRY}Point", *map(float, place))
        quaternion = self.made(f"{GEOMETRY}Quaternion", x=x, y=y, z=z, w=w)
        return self.made(f"{GEOMETRY}Pose", position=point, orientation=quaternion)

    def stamped(self, time_s, place, turn, frame="world"):
        """A pose with a head."""
        header = self.header(time_s, frame)
        return self.made(f"{GEOMETRY}PoseStamped", header=header, pose=self.pose(place, turn))

    def transform(self, time_s, parent, child, place, turn):
        """A transform from one frame to its parent."""
        x, y, z, w = turn.as_quat().tolist()
        moved = self.made(
            f"{GEOMETRY}Transform",
            translation=self.made(f"{GEOMETRY}Vector3", *map(float, place)),
            rotation=self.made(f"{GEOMETRY}Quaternion", x=x, y=y, z=z, w=w),
        )
        header = self.header(time_s, parent)
        kind = f"{GEOMETRY}TransformStamped"
        return self.made(kind, header=header, child_frame_id=child, transform=moved)

    def odometry(self, time_s, parent, child, place, turn):
        """A message of odometry, with speeds that are no positions."""
        vector = self.made(f"{GEOMETRY}Vector3", x=9.0, y=9.0, z=9.0)
        twist = self.made(f"{GEOMETRY}Twist", linear=vector, angular=vector)
        pose = self.pose(place, turn)
        covariance = np.zeros(36)
        return self.made(
            "nav_msgs/msg/Odometry",
            header=self.header(time_s, parent),
            child_frame_id=child,
            pose=self.made(f"{GEOMETRY}PoseWithCovariance", pose=pose, covariance=covariance),
            twist=self.made(f"{GEOMETRY}TwistWithCovariance", twist=twist, covariance=covariance),
        )

    def sent_transforms(self, transforms, topic="/tf", time_s=None):
        """Send transforms (parent, child, place, turn) at all times, or at one."""
        for time in TIMES_S if time_s is None else (time_s,):
            items = [self.transform(time, *transform) for transform in transforms]
            yield Sent(time, topic, TRANSFORMS, self.made(TRANSFORMS, transforms=items))

    def sent_poses(self, topic="/bot_{}/pose", *, names=None, lift=0.0, frame="world"):
        """Send a pose of each robot at all times, on a topic of its own."""
        for k in self.robots:
            name = k if names is None else names[k]
            for time in TIMES_S:
                place = self.place[k] + [0.0, 0.0, lift]
                message = self.stamped(time, place, self.turn[k], frame)
                yield Sent(time, topic.format(name), f"{GEOMETRY}PoseStamped", message)

    def sent_names(self, order, *, lacking=(), topic="/poses"):
        """Send a list with names at all times, in an order; a robot may lack at the last time."""
        for time in TIMES_S:
            robots = [k for k in order if time != TIMES_S[-1] or k not in lacking]
            items = [
                self.made(NAMED, name=f"cf{k}", pose=self.pose(self.place[k], self.turn[k]))
                for k in robots
            ]
            kind = f"{NAMED}Array"
            yield Sent(time, topic, kind, self.made(kind, header=self.header(time), poses=items))

    def sent_list(self, *, lacking=()):
        """Send a list without names at all times; a robot may lack at the last time."""
        for time in TIMES_S:
            robots = [k for k in self.robots if time != TIMES_S[-1] or k not in lacking]
            items = [self.pose(self.place[k], self.turn[k]) for k in robots]
            kind = f"{GEOMETRY}PoseArray"
            yield Sent(time, "/swarm", kind, self.made(kind, header=self.header(time), poses=items))

    def sent_models(self, others=()):
        """Send the states of all models of a simulator, others before the robots."""
        vector = self.made(f"{GEOMETRY}Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.made(f"{GEOMETRY}Twist", linear=vector, angular=vector)
        names = [*others, *(f"bot_{k}" for k in self.robots)]
        origin = [self.pose(np.zeros(3), Rotation.identity()) for _ in others]
        poses = [*origin, *(self.pose(self.place[k], self.turn[k]) for k in self.robots)]
        for time in TIMES_S:
            message = self.made(MODELS, name=names, pose=poses, twist=[twist] * len(names))
            yield Sent(time, "/gazebo/model_states", MODELS, message)

    def record(self, folder, messages):
        """Write a bag; returns its path."""
        path = folder / ("run.bag" if self.ros == 1 else "run")
        bag = rosbag1.Writer(path) if self.ros == 1 else rosbag2.Writer(path, version=9)
        links = {}
        with bag:
            for time_s, topic, kind, message in sorted(messages, key=lambda sent: sent.time_s):
                if topic not in links:
                    links[topic] = bag.add_connection(topic, kind, typestore=self.store)
                write = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
                bag.write(links[topic], round(1e9 * time_s), write(message, kind))
        return path
