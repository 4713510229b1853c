"""Ways of messages from robot to robot: known to all, or learned from messages that came.

| routes | a robot knows |
|---|---|
| `known` | the shortest way along contacts to each robot, though no message let it know |
| `learned` | those that it touches, and by whom the last message of each other robot came to it |

Learned routes are those of AODV (Perkins and Royer, Ad-hoc On-Demand Distance Vector Routing, IEEE
WMCSA 1999): the way back to a sender is the way of its message. A message to a robot without a
route goes to all that the robot at hand touches, and each passes it on once. Of two ways a robot
keeps that of the message that was sent later, so that ways have no loops.
"""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Literal, Protocol

import numpy as np

from tiswarm.base.aliases import Ints

ROUTE = 6
"""Bytes of a learned route: the robot, whom to pass on to, and the number of the message."""

Links = Sequence[Collection[int]]
"""By robot, those in contact, or in reach of its radio."""


class Way(Protocol):
    """The way of one message."""

    meets_once: bool
    """Whether no robot meets the message on two ways."""

    def onward(self, robot: int, receivers: Collection[int]) -> Mapping[int, set[int]]:
        """Choose whom a robot passes the message on to.

        Args:
            robot: The robot that has the message.
            receivers: Robots that it is to reach from there.

        Returns:
            By robot that is to hear it next, the receivers that it is to reach by that one, itself
            included if it is one.
        """

    def learn(self, robot: int, heard_from: int) -> None:
        """Take note of whom a robot has the message from."""


class Routes(Protocol):
    """What robots know of the ways to each other."""

    def way(self, message: int, sender: int, receivers: set[int]) -> Way:
        """Return the way of a message, by its number and sender, to its receivers."""

    @property
    def memory(self) -> Ints:
        """Bytes of the routes that each robot holds, shape (N,)."""


def of(name: Literal["known", "learned"], links: Links) -> Routes:
    """Return the routes that the settings name; `links` may grow and change later."""
    return KnownRoutes(links) if name == "known" else LearnedRoutes(links)


def tree(links: Links, root: int, targets: set[int]) -> dict[int, list[int]]:
    """Find shortest ways to some robots: by robot, whom it passes a message on to."""
    parent: dict[int, int] = {root: root}
    queue = deque([root])
    unreached = {*targets} - {root}
    while queue and unreached:
        robot = queue.popleft()
        for neighbor in sorted(links[robot]):
            if neighbor not in parent:
                parent[neighbor] = robot
                unreached.discard(neighbor)
                queue.append(neighbor)
    children: dict[int, list[int]] = {}
    for target in sorted(targets & parent.keys() - {root}):
        robot = target
        while robot != root and robot not in children.get(parent[robot], []):
            children.setdefault(parent[robot], []).append(robot)
            robot = parent[robot]
    return children


class KnownWay:
    """A tree of shortest ways, which each robot on it knows."""

    meets_once = True

    def __init__(self, children: Mapping[int, list[int]]) -> None:
        """Take the tree: by robot, whom it passes the message on to."""
        self._children = children

    def onward(self, robot: int, _: Collection[int]) -> dict[int, set[int]]:
        """Pass the message on to the children of a robot, each with all that is behind it."""
        return {child: self._behind(child) for child in self._children.get(robot, [])}

    def learn(self, robot: int, heard_from: int) -> None:
        """Learn nothing: ways are known."""

    def _behind(self, robot: int) -> set[int]:
        """List a robot and all to which it passes the message on."""
        subtree = {robot}
        queue = [robot]
        while queue:
            children = self._children.get(queue.pop(), [])
            subtree.update(children)
            queue += children
        return subtree


class KnownRoutes:
    """Robots that know shortest ways along contacts."""

    def __init__(self, links: Links) -> None:
        """Take who is in reach of whom."""
        self._links = links

    def way(self, _: int, sender: int, receivers: set[int]) -> KnownWay:
        """Find shortest ways to the receivers that can be reached."""
        return KnownWay(tree(self._links, sender, receivers))

    @property
    def memory(self) -> Ints:
        """Nothing: how robots know ways is left open."""
        return np.zeros(len(self._links), np.int64)


class LearnedRoutes:
    """Robots that know by whom messages of others came to them."""

    def __init__(self, links: Links) -> None:
        """Take who is in reach of whom."""
        self._links = links
        self._routes: dict[int, dict[int, tuple[int, int]]] = {}
        """By robot and sender, the number of its last message and the robot by which it came."""

    def way(self, message: int, sender: int, _: set[int]) -> "LearnedWay":
        """Return the way of a message, which robots find as it goes."""
        return LearnedWay(self, message, sender)

    @property
    def memory(self) -> Ints:
        """Bytes of the routes that each robot holds, shape (N,)."""
        counts = [len(self._routes.get(robot, ())) for robot in range(len(self._links))]
        return ROUTE * np.array(counts, np.int64)

    def next_to(self, robot: int, receiver: int) -> int | None:
        """Return by whom a robot reaches another one; None if it knows no way."""
        if receiver in self._links[robot]:
            return receiver
        _, neighbor = self._routes.get(robot, {}).get(receiver, (0, None))
        # A neighbor that left leads nowhere.
        return neighbor if neighbor in self._links[robot] else None

    def neighbors(self, robot: int) -> list[int]:
        """List whom a robot reaches at once, ascending."""
        return sorted(self._links[robot])

    def hold(self, robot: int, sender: int, message: int, heard_from: int) -> None:
        """Let a robot take note of the way back to a sender, if it has none of a later message."""
        of_robot = self._routes.setdefault(robot, {})
        last, _ = of_robot.get(sender, (-1, -1))
        if robot != sender and message > last:
            of_robot[sender] = message, heard_from


class LearnedWay:
    """A message that goes by what robots have learned, and where they know nothing, to all."""

    meets_once = False

    def __init__(self, routes: LearnedRoutes, message: int, sender: int) -> None:
        """Begin at the sender of a message, by its number."""
        self._routes = routes
        self._message, self._sender = message, sender
        self._heard_from: dict[int, int] = {}

    def learn(self, robot: int, heard_from: int) -> None:
        """Let a robot hold the way back to the sender."""
        self._heard_from.setdefault(robot, heard_from)
        self._routes.hold(robot, self._sender, self._message, heard_from)

    def onward(self, robot: int, receivers: Collection[int]) -> dict[int, set[int]]:
        """Pass each part on by its route; without one, to all but whom the message came from."""
        came_from = self._heard_from.get(robot)
        onward: dict[int, set[int]] = {}
        for receiver in sorted(receivers):
            route = self._routes.next_to(robot, receiver)
            if route is None or route == came_from:
                nearby = self._routes.neighbors(robot)
                chosen = [neighbor for neighbor in nearby if neighbor != came_from]
            else:
                chosen = [route]
            for neighbor in chosen:
                onward.setdefault(neighbor, set()).add(receiver)
        return onward
