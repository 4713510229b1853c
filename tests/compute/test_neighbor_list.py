"""The neighbor list's rows and its hash, for swarms of any shape."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from tests.engine.test_relax import arms, swarm
from tiswarm.compute import backend
from tiswarm.compute.backend import Allocator, Backend
from tiswarm.compute.neighbor_kernels import LONGEST_RUN
from tiswarm.compute.neighbor_list import (
    FEWEST_BUCKETS,
    NeighborList,
    hash_strides,
)
from tiswarm.engine.stepping import morton_order

SIDE = st.floats(0.0, 1e12)


@given(extent=st.tuples(SIDE, SIDE, SIDE), doublings=st.integers(0, 20))
def test_cells_around_a_dock_never_share_a_bucket(extent, doublings):
    """So no neighbor is counted twice: four runs of cells, to either side along y and z."""
    buckets = FEWEST_BUCKETS << doublings
    stride_y, stride_z = hash_strides(np.array(extent), 2.5, buckets)

    for side_y in (-stride_y, stride_y):
        for side_z in (-stride_z, stride_z):
            first = np.array([0, side_y, side_z, side_y + side_z])
            run = (first[:, None] + np.arange(LONGEST_RUN)) % buckets
            assert len(np.unique(run)) == 4 * LONGEST_RUN


def test_neighbors_along_the_curve_are_neighbors_in_space():
    """Order of the corners of a cube, and structures apart."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    order = morton_order(corner, np.zeros(8, np.int64))
    assert corner[order].tolist() == sorted(corner.tolist(), key=lambda c: c[::-1])
    assert morton_order(corner, np.arange(8)[::-1]).tolist() == list(range(8))[::-1]


@pytest.mark.parametrize("on_card", [False, True], ids=["processor", "card"])
@pytest.mark.parametrize("place", ["spread", "crowded", "far"])
def test_rows_list_connected_docks_and_every_near_one_once(monkeypatch, on_card, place):
    """24,000 robots: so many buckets that the totals of their blocks are summed in blocks too.

    In a crowd, runs of cells hold more docks than are compared at a time. Far away, steps of the
    fine grid round.
    """
    monkeypatch.setattr(Backend, "on_card", on_card)
    position, orientation, contacts = swarm(24_000)
    position = position * (0.5 if place == "crowded" else 1.0) + (1e9 if place == "far" else 0.0)
    dock = (position[:, None] + arms(orientation)).reshape(-1, 3)
    memory = Allocator(backend.current(), on_host=False)
    lists = NeighborList(memory, position, contacts, docks=3, reach=2.0, cutoff=2.5)
    assert lists.totals[1].shape[0] > 1

    lists.build(memory.upload(np.column_stack([dock, np.zeros(len(dock))]).ravel()), 0)

    near = cKDTree(dock).query_pairs(2.5, output_type="ndarray")
    near = near[near[:, 0] // 3 != near[:, 1] // 3]
    pairs = np.concatenate([contacts[:, [0, 2]] * 3 + contacts[:, [1, 3]], near])
    number = np.sort(pairs, axis=1) @ [len(dock), 1]  # sorted in a tenth of the time of rows
    at = np.unique(number, return_index=True)[1]
    first, flag = np.sort(pairs[at], axis=1), at < len(contacts)
    expected = np.concatenate([np.c_[first, flag], np.c_[first[:, ::-1], flag]])
    np.testing.assert_array_equal(in_order(listed(lists)), in_order(expected))


def listed(lists):
    """Decode all rows: own dock, other dock, and whether they are connected."""
    entry, first, count = (array.to_numpy() for array in lists.rows)
    row = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(row)) - np.repeat(count.cumsum() - count, count)
    found, bits = entry[first[row] + within * lists.entry_stride], lists.own_bits
    own = row * lists.row_docks + found % (1 << bits)
    return np.column_stack([own, found >> (bits + 1), found >> bits & 1])


def in_order(table):
    """Sort the rows of a table of whole numbers from 0, each row as one number of 64 bits."""
    least = np.cumprod([1, *(table.max(axis=0, initial=0)[:0:-1] + 1)])[::-1]
    return table[np.argsort(table @ least)]
