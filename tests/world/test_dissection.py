"""Nested dissection orders graphs so that elimination fills in little."""

import sys

import numpy as np
import pytest
from pydantic import ValidationError

from benchmarks.growth import load_difference
from tests import frames
from tiswarm.base.robot import RobotGeometry
from tiswarm.world.dissection import dissected
from tiswarm.world.growth import grow
from tiswarm.world.mechanics import MechanicsParams
from tiswarm.world.params import TowerParams


def _grid(side):
    """Pairs of neighbors in a square grid, whose nodes have every third number."""
    number = 3 * np.arange(side**2).reshape(side, side)
    across = np.stack([number[:, :-1], number[:, 1:]], axis=-1)
    up = np.stack([number[:-1], number[1:]], axis=-1)
    return number.ravel(), np.concatenate([across.reshape(-1, 2), up.reshape(-1, 2)])


def _edges_when_eliminated(order, pairs):
    """Count the edges of a graph with all fill-in, by sets of neighbors."""
    near = {node: set() for node in order}
    for a, b in pairs.tolist():
        near[a].add(b)
        near[b].add(a)
    edges = 0
    for node in order:
        neighbors = near.pop(node)
        edges += len(neighbors)
        for a in neighbors:
            near[a] |= neighbors - {a}
            near[a].discard(node)
    return edges


@frames.needs_metis
def test_a_grid_fills_in_as_theory_says():
    """Row by row, n edges a node fill in; dissected, some 31/4 log2 n (George, 1973)."""
    side = 32
    nodes, pairs = _grid(side)

    order = dissected(nodes, pairs)

    assert sorted(order) == nodes.tolist()
    edges = _edges_when_eliminated(order.tolist(), pairs)
    assert edges < 31.0 / 4.0 * side**2 * np.log2(side)
    assert edges < 0.6 * _edges_when_eliminated(nodes.tolist(), pairs)


@frames.needs_metis
def test_an_order_depends_on_the_graph_alone():
    """Two orders of one graph are one, whatever was ordered between."""
    nodes, pairs = _grid(20)

    first = dissected(nodes, pairs)
    dissected(*_grid(15))

    np.testing.assert_array_equal(dissected(nodes, pairs), first)


def test_nodes_without_neighbors_stay_as_they_are():
    """Nothing is left for METIS where all nodes were leaves."""
    assert dissected(np.array([2, 5]), np.empty((0, 2), np.int32)).tolist() == [2, 5]


@frames.needs_metis
@pytest.mark.parametrize("robots", [40, pytest.param(1_000, marks=pytest.mark.trial)])
def test_forces_are_those_of_a_direct_solver(robots):
    """SciPy solves the system of a tower that grew by this order; the error is that of rounding."""
    params = MechanicsParams(model="rigid", order="nested-dissection")
    tower = TowerParams(movers=1 + robots // 100, solve_every=robots, mechanics=params)
    [history] = grow(tower, robots=robots, seeds=[1], robot=RobotGeometry())

    solved = frames.solved(frames.grown(history), params)

    assert load_difference(solved) < 1e-8


def test_docks_that_rest_are_refused():
    """The slips of their feet need solutions for many loads, which panels do not keep."""
    with pytest.raises(ValidationError, match="solved by minimum-degree; leave order out"):
        MechanicsParams(ground="rests", friction=0.5, order="nested-dissection")


def test_without_metis_a_line_says_what_to_install(tiswarm, tmp_path, monkeypatch):
    """Nothing grows by another order than the one asked for."""
    monkeypatch.setitem(sys.modules, "pymetis", None)

    settings = ("--set", "robots=4", "--set", "structure.mechanics.order=nested-dissection")
    done = tiswarm("run", "tests/tower.yaml", *settings, "--out", tmp_path / "out")

    assert done.returncode == 1
    assert done.stderr.endswith("needs METIS; pip install 'tiswarm[large]'\n")
    assert len(done.stderr.splitlines()) == 1
