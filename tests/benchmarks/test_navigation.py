"""Errors that the benchmark of navigation adds to the truth are of the kind that it names."""

import numpy as np
import pytest

from benchmarks import navigation
from tiswarm.base.robot import RobotGeometry
from tiswarm.world.growth import grow
from tiswarm.world.params import BridgeParams


@pytest.fixture(scope="module")
def bridges():
    """One bridge with eight robots, and with twelve."""
    return [
        grow(BridgeParams(gap=30.0), robots=robots, seeds=[0], robot=RobotGeometry())[0]
        for robots in (8, 12)
    ]


@pytest.mark.parametrize("kind", ["independent", "shift", "turn", "adding up"])
def test_anchors_know_their_places_and_robots_keep_their_errors(bridges, kind):
    """A robot whose error changed with each join would not go by one wrong belief."""
    small, large = (navigation.error_of(bridge, kind, 0.5) for bridge in bridges)

    first = navigation.touched_first(bridges[1])
    anchors = [j for j, i in enumerate(first) if i == j]
    assert len(anchors) == 2
    assert (large[anchors] == 0.0).all()
    np.testing.assert_allclose(large[:8], small, atol=1e-12)
    assert np.abs(np.delete(large, anchors, axis=0)).max() > 0.1


def test_errors_are_shared_or_add_up_as_their_names_say(bridges):
    """One shift for all but the anchors; else that of the robot touched first and an own draw."""
    first = np.array(navigation.touched_first(bridges[1]))
    follows = first != np.arange(12)

    shift = navigation.error_of(bridges[1], "shift", 3.0)
    own, added = (
        navigation.error_of(bridges[1], kind, 1.0) for kind in ("independent", "adding up")
    )
    turn = navigation.error_of(bridges[1], "turn", 0.4)

    np.testing.assert_allclose(np.linalg.norm(shift[follows], axis=1), 3.0)
    assert np.ptp(shift[follows], axis=0).max() == 0.0
    np.testing.assert_allclose((added - added[first])[follows], own[follows], atol=1e-12)
    arm = bridges[1].position - bridges[1].position[navigation.anchor_of(first)]
    np.testing.assert_allclose(
        np.linalg.norm(turn, axis=1), 2.0 * np.sin(0.2) * np.hypot(*arm[:, :2].T), atol=1e-12
    )


def test_the_command_prints_a_row_for_each_kind(capsys):
    """The first row is the truth, against which p is."""
    assert navigation.main(["--seeds", "1", "--robots", "6"]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(navigation.CASES)
    assert lines[1].split()[0] == "none"
