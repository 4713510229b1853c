"""Algorithm 1 while the structure grows: a robot joins, and is placed at once."""

import json
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tiswarm.compute import backend
from tiswarm.compute.cell_kernels import CellChains
from tiswarm.compute.math import dock_offsets
from tiswarm.errors import InputError
from tiswarm.localization.join_order_kernels import localize_in_join_order
from tiswarm.localization.params import LocalizationParams, VirtualForceParams
from tiswarm.localization.virtual_force import check_placed, directions, gains
from tiswarm.records.messages import counted
from tiswarm.records.sensing_file import SensingLogBuilder
from tiswarm.records.sensing_format import parse_header, parse_robot
from tiswarm.records.sensing_log import SensingLog

Line = str | Mapping[str, object]
"""A line of a sensing file, as text or as what its JSON says."""


class Localizer:
    """Places robots one by one as they join, each at once and for good.

    The kernel is the one that localizes whole logs, so the positions are the same, bit for bit.
    """

    def __init__(
        self,
        header: Line,
        params: LocalizationParams | None = None,
        *,
        capacity: int = 10_000,
    ) -> None:
        """Prepare for robots to join.

        Args:
            header: First line of a sensing file.
            params: Settings of `virtual-force`; its defaults if None.
            capacity: Robots that there is room for.

        Raises:
            InputError: the header is malformed, or robots cannot be placed one by one this way.
        """
        chosen = VirtualForceParams() if params is None else params
        if not isinstance(chosen, VirtualForceParams):
            msg = f"{chosen.method} places all robots at once; localize the log once it is whole"
            raise InputError(msg)
        if chosen.back_propagation is not None:
            msg = "back_propagation moves robots that have been placed; switch it off to join"
            raise InputError(msg)
        head = parse_header(_text(header))
        self._params = chosen
        self._unit = head.dock_radius
        self._builder = SensingLogBuilder(head)
        self._noise = head.noise
        self._dock_body = np.array(head.dock_offsets, np.float64) / self._unit
        docks, dtype = len(self._dock_body), backend.current().dtype
        self._chains = CellChains.allocate(1, capacity * docks)
        self._count = 0
        self._dock_offset = np.zeros((capacity, docks, 3), dtype)
        self._direction = np.zeros((capacity, 3), dtype)
        self._height = np.full(capacity, np.nan, dtype)
        self._position = np.full((capacity, 3), np.nan, dtype)
        self._yaw = np.zeros(capacity, dtype)
        self._position[0] = np.array(head.anchor_position) / self._unit
        self._contact_start = np.zeros(capacity + 1, np.int32)

    @property
    def log(self) -> SensingLog:
        """What the robots have sensed so far."""
        return self._builder.log()

    @property
    def positions(self) -> NDArray[np.float64]:
        """Where the robots are thought to be, in the log's unit, in join order, shape (n, 3)."""
        return np.multiply(self._position[: self._count], self._unit, dtype=np.float64)

    def join(self, robot: Line) -> NDArray[np.float64]:
        """Place the next robot; the first one is the anchor.

        Args:
            robot: Its line of a sensing file.

        Returns:
            Where it is thought to be, in the log's unit, shape (3,).

        Raises:
            InputError: the line is malformed, or there is no more room.
        """
        if self._count == len(self._position):
            msg = f"capacity is {counted(self._count, 'robot')}; make a Localizer with more"
            raise InputError(msg)
        line = parse_robot(_text(robot))
        stance = self._builder.add(line)
        n, orientation = self._count, np.array([stance.orientation_wxyz])
        self._dock_offset[n] = dock_offsets(orientation, self._dock_body)[0]
        self._direction[n] = directions(orientation, self._params)[0]
        self._height[n] = np.nan if line.flip_height is None else line.flip_height / self._unit
        self._place(np.array(stance.lists["contacts"], np.int32).reshape(-1, 3))
        self._count += 1
        position: NDArray[np.float64] = self._position[n].astype(np.float64) * self._unit
        return position

    def _place(self, contact: NDArray[np.int32]) -> None:
        """Launch Algorithm 1 for the last robot alone."""
        dtype, count = self._position.dtype, self._count
        every = self._params.iterations
        self._contact_start[count : count + 2] = 0, len(contact)
        localize_in_join_order(
            every, 1, 0, every, np.array([gains(self._params, self._noise)], dtype),
            np.array([0, count + 1], np.int32), np.array([count], np.int32), self._contact_start,
            contact, self._dock_offset, self._direction, self._height, self._chains.head,
            self._chains.following, self._yaw, self._position,
            np.empty((2, *self._position.shape), dtype), np.empty((2, len(self._position)), dtype),
        )  # fmt: skip
        check_placed(self._position[: count + 1])


def _text(line: Line) -> str:
    return line if isinstance(line, str) else json.dumps(line)
