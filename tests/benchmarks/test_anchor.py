"""The comparison of rules for the anchor counts what structures are, and localizes nothing."""

import ast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import paper_facts
from benchmarks.reactivebuild import anchor, criterion
from tests import oracle


def test_facts_are_those_of_the_structures(towers):
    """A robot that never touches the anchor is infinitely late, not left out."""
    short = replace(towers[0], walks=towers[0].walks[:1], loads=towers[0].loads[:1])

    found = anchor.facts([towers[1], towers[2], short], robots=30)

    assert found["complete"] == 2 / 3
    late = [2 not in set(history.contacts[history.contacts[:, 0] == 0, 2]) for history in towers]
    assert found["both_at_once"] == (2 - sum(late[1:])) / 3
    assert (found["first_quartile"], found["first_on_anchor"]) == (1.0, 1.0)
    assert found["third_quartile"] == np.inf
    spread = [history.position - history.position.mean(axis=0) for history in towers[1:]]
    size = sum(np.sqrt((offset**2).sum(axis=1).mean()) for offset in spread) / 3
    np.testing.assert_allclose(found["rms_radius_R"], size)


def test_near_docks_are_those_of_two_robots_that_do_not_touch(towers):
    """The count is that of a loop over all pairs of docks."""
    history = towers[0]
    contacts = {tuple(row) for row in history.contacts.tolist()}
    docks = [
        (i, a, place + oracle.matrix(turn) @ arm)
        for i, (place, turn) in enumerate(
            zip(history.position, history.orientation_wxyz, strict=True)
        )
        for a, arm in enumerate(history.robot.dock_offset_body)
    ]

    near = [
        np.linalg.norm(one - other) < 2.0 + paper_facts.NEAR and (i, a, j, b) not in contacts
        for i, a, one in docks
        for j, b, other in docks
        if i < j
    ]

    assert anchor.near_docks(history) == sum(near) / history.robot_count > 0.0


@pytest.mark.parametrize(
    ("heights", "narrows"), [([1, 1, 1, 4, 4, 9], True), ([1, 4, 4, 9], False)]
)
def test_pyramids_have_ever_fewer_robots_in_each_third_of_the_height(heights, narrows):
    """A robot more in the middle than at the bottom is no pyramid."""
    history = SimpleNamespace(position=np.zeros((len(heights), 3)), ground_z=0.0)
    history.position[:, 2] = heights

    assert anchor.narrows(history) == narrows


def test_every_rule_can_be_grown():
    """Towers have no edge to put the anchor behind."""
    found = list(anchor.rules())

    assert len({str(rule) for rule in found}) == len(found) == 10 * (7 * 4 + 9)
    assert not [rule for rule in found if rule["kind"] == "tower" and "anchor" in rule]


def test_the_shape_of_a_cantilever_is_what_lies_on_either_side_of_the_edge():
    """The reach is counted from the edge outward, the carpet backward."""
    edge = SimpleNamespace(is_plane=False)
    history = SimpleNamespace(position=np.zeros((3, 3)), terrain=edge)
    history.position[:, 0] = -12.0, 4.5, 9.0

    assert (anchor.of_goal(history), anchor.carpet(history)) == (0.2, 12.0)


def test_a_tower_has_the_share_of_the_goal_that_its_height_is():
    """A tower has no edge, and no carpet behind it."""
    history = SimpleNamespace(position=np.zeros((2, 3)), terrain=SimpleNamespace(is_plane=True))
    history.position[1, 2] = 13.0

    assert anchor.of_goal(history) == 0.2
    assert np.isnan(anchor.carpet(history))


def test_no_estimate_is_in_reach():
    """Rules are to be chosen by structures: the program imports no localizer."""
    nodes = [node for file in (anchor, criterion) for node in ast.walk(_tree(file))]

    modules = [node.module for node in nodes if isinstance(node, ast.ImportFrom)]
    assert modules
    assert not [name for name in modules if "localization" in name or "sensing" in name]


def _tree(module):
    return ast.parse(Path(module.__file__).read_text())
