"""The neighbor list: for each robot, the docks of others near its own.

A counting sort puts docks into cells, by a linear hash, so that boxes of any size do. The neighbors
of each robot, on graphics cards of each dock, then stand in a row (a Verlet list), which is valid
until a robot has moved by half the skin. Rows that do not fit are counted, given more room and
written again: no neighbor is dropped.
"""

from itertools import pairwise

import numpy as np

from tiswarm.base.aliases import Ints, Reals
from tiswarm.base.errors import InputError
from tiswarm.compute import neighbor_kernels as kernels
from tiswarm.compute.backend import Allocator
from tiswarm.compute.lang import DeviceArray
from tiswarm.compute.neighbor_kernels import ConnectedDocks, Rows, StructureTable

MOST_ITEMS = 2**31 - 1
"""Largest number that the kernels' integers can hold."""
FEWEST_BUCKETS = 64
"""Smallest table in which no two cells around a dock share a bucket."""
_FIRST_CAPACITY = 8
"""Entries to begin with, for each dock of a row, where many rows share their room."""
_RUN = 512
"""Rows that a core writes in succession, so that they lie close in memory."""
_ROOM = 1.25
"""Factor of the room that was needed, when more is made."""


def hash_strides(extent: Reals, cutoff: float, buckets: int) -> tuple[int, int]:
    """Choose the strides of the linear hash, so that the table is the box where that fits.

    A larger box is folded into the table: cells far apart may share a bucket, cells around a
    dock never do.

    Args:
        extent: Sides of the box around all docks [R], shape (3,).
        cutoff: Reach of a dock [R].
        buckets: Size of the table, a power of two.

    Returns:
        Buckets from one cell to the next along y, and along z.
    """
    edge = cutoff * np.array([kernels.CELL_LENGTH, kernels.CELL_WIDTH, kernels.CELL_WIDTH])
    # A run, or a neighbor on either side, extends beyond the box.
    padding = np.array([kernels.LONGEST_RUN + 1, 3, 3])
    cells = np.ceil(extent / edge) + padding
    excess = cells.prod() / buckets
    while excess > 1.0 and (cells > padding).any():
        widest = np.argmax(np.where(cells > padding, cells * edge, 0.0))
        cells[widest] = max(padding[widest], np.floor(cells[widest] / min(excess, 2.0)))
        excess = cells.prod() / buckets
    stride_y = int(cells[0]) | 1
    return stride_y, (stride_y * int(cells[1])) | 1


def _layout(position: Reals, bounds: Ints, *, docks: int, reach: float, cutoff: float) -> Ints:
    """Lay out the tables: columns FIRST to STRIDE_Z of each structure, shape (S, 6)."""
    rows = []
    at = 0
    for first, last in pairwise(bounds):
        buckets = max(FEWEST_BUCKETS, 1 << (docks * int(last - first) - 1).bit_length())
        extent = np.ptp(position[first:last], axis=0) + 2.0 * reach
        rows.append((first, last, at, buckets, *hash_strides(extent, cutoff, buckets)))
        at += buckets + 2
    return np.array(rows, np.int64)


class NeighborList:
    """Rows of neighbors on the device, for one swarm or for many small structures.

    Robots of one structure stand together; those of different ones are never neighbors. Sorted
    docks, connected docks and rows are the bundles of `tiswarm.compute.neighbor_kernels`.
    """

    def __init__(
        self,
        memory: Allocator,
        position: Reals,
        contacts: Ints,
        *,
        docks: int,
        reach: float,
        cutoff: float,
        start: Ints | None = None,
        unit: float | None = None,
    ) -> None:
        """Reserve memory.

        Args:
            memory: Where rows and tables go.
            position: Centers at first, by which tables are laid out, shape (N, 3).
            contacts: Rows of (robot i, dock, robot j, dock), shape (C, 4).
            docks: Docks of a robot.
            reach: How far docks are from the center.
            cutoff: Docks nearer than this are neighbors; it may be set farther later.
            start: First robot of each structure, shape (S + 1,), for a table each; None for
                one table.
            unit: What places of docks are whole numbers of; None for real places.

        Raises:
            InputError: where there are more docks than an entry can number.
        """
        self.memory = memory
        robots = len(position)
        self.robots = robots
        self.docks = docks
        self.cutoff = cutoff / (unit or 1.0)
        self.on_card = memory.running.on_card
        row_docks = 1 if self.on_card else docks
        self.row_docks = row_docks
        self.row_count = robots * docks // row_docks
        self.own_bits = (row_docks - 1).bit_length()
        self.run = 1 if self.on_card else _RUN
        # A core reads along a row, a graphics card the same entry of many rows at once.
        self.entry_stride = self.row_count if self.on_card else 1
        # A row of its own has to hold more than what rows need on average.
        self.capacity = _FIRST_CAPACITY * row_docks * (2 if self.on_card else 1)
        bounds = np.array([0, robots]) if start is None else start
        tables = _layout(position, bounds, docks=docks, reach=reach, cutoff=cutoff)
        self.table_size = int(
            tables[-1, StructureTable.TABLE] + tables[-1, StructureTable.BUCKETS] + 2
        )
        self._check_size()
        strides = tables[0, [StructureTable.STRIDE_Y, StructureTable.STRIDE_Z]]
        self.stride_y, self.stride_z = (int(stride) for stride in strides)
        seldom = memory.for_few_launches()
        self.structure = memory.upload(np.pad(tables, ((0, 0), (0, 4))))
        self._share_room()
        first, entry = self._pack(contacts)
        self.connections = ConnectedDocks(start=seldom.upload(first), entry=seldom.upload(entry))
        self.cells = kernels.Cells(
            begin=seldom.ints(self.table_size),
            dock=seldom.ints(robots * docks),
            place=seldom.ints(robots * docks + kernels.BLOCK),
        )
        blocks = -(-self.table_size // kernels.SCAN_BLOCK)
        self.totals = seldom.ints(blocks), seldom.ints(-(-blocks // kernels.SCAN_BLOCK))
        self.longest = seldom.ints(1)
        sizes = self._row_size(), self.row_count, self.row_count
        entries, first, count = (memory.ints(size) for size in sizes)
        self.rows = Rows(entries, first, count)
        self.builds = 0

    def _pack(self, contacts: Ints) -> tuple[Ints, Ints]:
        """Write contacts as entries of the rows of both, in an order that is the contacts' own.

        Returns:
            First entry of each row, shape (rows + 1,), and entries, shape (2 C,).
        """
        robot, dock, other_robot, other_dock = contacts.T
        first = robot * self.docks + dock
        second = other_robot * self.docks + other_dock
        row, dock_of_row = np.divmod(np.concatenate([first, second]), self.row_docks)
        bits = self.own_bits
        entry = (np.concatenate([second, first]) << (bits + 1)) | (1 << bits) | dock_of_row
        start = np.bincount(row, minlength=self.row_count).cumsum()
        # One sort by row and then by entry: forces add up in the same order each time.
        by_row = np.sort((row << 32) | entry) & MOST_ITEMS
        return np.r_[0, start], by_row if len(by_row) else np.zeros(1, np.int64)

    def build(self, dock: DeviceArray, base: int) -> None:
        """Write all rows anew, as long as they need to be; arguments as for `write`."""
        self.write(dock, base)
        while self.lack_room():
            self.write(dock, base)
        self.builds += 1

    def write(self, dock: DeviceArray, base: int) -> None:
        """Write all rows anew, as far as there is room, without waiting for the device.

        Args:
            dock: Places of docks and, last, their structure: rows of four.
            base: Where in `dock` the current ones start.
        """
        kernels.sort_docks(
            self.docks, self.cutoff, self.stride_y, self.stride_z, base, dock, *self.totals,
            *self.cells,
        )  # fmt: skip
        room = self.room
        run_stride = room + 1 if self.run > 1 else 1
        kernels.fill_rows(
            self.on_card, self.docks, self.own_bits, self.cutoff, self.stride_y, self.stride_z,
            self.entry_stride, self.run, run_stride, room, base, dock, self.longest,
            *self.cells, *self.connections, *self.rows,
        )  # fmt: skip

    @property
    def room(self) -> int:
        """Entries that fit for the rows that a core writes in succession."""
        return self.run * self.capacity

    def lack_room(self) -> bool:
        """Whether rows did not fit as they were written; if so, make room for them."""
        used = int(self.longest[0])
        if used <= self.room:
            return False
        self.make_room(used / self.run)
        return True

    def fullest(self) -> float:
        """Count the entries a robot that rows need, in the structure that needs most."""
        table = self.memory.download(self.structure)
        robots = table[:, StructureTable.END] - table[:, StructureTable.FIRST]
        return float((table[:, StructureTable.LONGEST] / robots).max())

    def make_room(self, entries: float) -> None:
        """Make room for `entries` a row, and some more.

        Raises:
            InputError: where that is more than can be numbered.
        """
        self.capacity = int(_ROOM * entries) + 1
        self._check_size()
        self.rows = self.rows._replace(entry=self.memory.ints(self._row_size()))
        self._share_room()

    def _share_room(self) -> None:
        """Share the room for entries among structures, by their robots."""
        table = self.memory.download(self.structure)
        first = table[:, StructureTable.FIRST]
        end = table[:, StructureTable.END]
        table[:, StructureTable.ROW] = first * self.capacity + np.arange(len(table))
        table[:, StructureTable.ROOM] = (end - first) * self.capacity
        self.memory.refill(self.structure, table)

    def _row_size(self) -> int:
        """Count the numbers that rows need, run by run or structure by structure."""
        runs = -(-self.row_count // self.run)
        return max(runs * (self.run * self.capacity + 1), self.row_count * (self.capacity + 1))

    def _check_size(self) -> None:
        """Refuse swarms that the kernels' integers cannot number."""
        docks = self.robots * self.docks
        largest = max(docks << (self.own_bits + 1), self._row_size(), self.table_size, 8 * docks)
        if largest > MOST_ITEMS:
            raise InputError(
                f"{self.robots} robots with {self.docks} docks and up to {self.capacity} neighbors "
                f"need {largest} numbers in one table, more than {MOST_ITEMS}; "
                "split the swarm into parts that do not touch"
            )
