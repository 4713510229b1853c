"""The count of floppy modes is what moving the robots shows."""

import itertools

import numpy as np
import pytest

from tiswarm.compute.math import dock_offsets
from tiswarm.measurements import rigidity
from tiswarm.measurements.linear import equations
from tiswarm.measurements.observability import by_cue, observability
from tiswarm.measurements.odometry import displacements
from tiswarm.measurements.rigidity import HELD, floppy_modes, loose, weld
from tiswarm.sensing import SensingParams, observe

CUES = ("contacts", "ground", "height", "walk_contacts", "odometry")


@pytest.fixture(scope="module")
def logs(towers):
    """What the robots of each tower sensed, their spawns included."""
    return [observe(history, SensingParams(spawn_noise=0.0)) for history in towers]


def _sensed(position, yaw, log):
    """Every distance of docks in contact now or once, every height and place, dock by dock."""
    turn = [
        np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]]) for y in yaw
    ]
    turned = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    distance = [
        np.linalg.norm(position[i] + turn[i] @ turned[i, a] - position[j] - turn[j] @ turned[j, b])
        for i, a, j, b in log.contacts
    ]
    stances = log.stances
    then = dock_offsets(stances.orientation_wxyz, log.dock_offset_body)
    back = displacements(log, stances)
    owner = [int(np.searchsorted(stances.start, row, "right")) - 1 for row in range(len(then))]
    for row, own, i, a in stances.contacts:
        j = owner[row]
        dock = position[j] + turn[j] @ (back[row] + then[row, own])
        distance.append(np.linalg.norm(dock - position[i] - turn[i] @ turned[i, a]))
    ground = [position[j, 2] + turned[j, own, 2] for j, own in log.ground_docks]
    ground += [position[owner[row], 2] + then[row, own, 2] for row, own in stances.ground_docks]
    begun = [
        p + turn[j] @ (back[owner.index(j)] if j in owner else 0 * p)
        for j, p in enumerate(position)
    ]
    return np.r_[distance, position[0], ground, position[:, 2], np.ravel(begun)]


def _matrix(position, log, cues, *, turning=False):
    """Derivatives of what is sensed by x, y and z, and yaw [dock radius], of every robot."""
    known = equations(position, log, cues, turning=turning)
    matrix = np.zeros((len(known.way), log.robot_count + 1, 4))
    for row, (i, j, way) in enumerate(zip(*known[:3], strict=True)):
        for robot, sign in ((j, 1.0), (i, -1.0)):
            x, y, _ = known.center[robot]
            matrix[row, robot, :3] += sign * way[:3]
            if turning:  # told from the robot itself
                matrix[row, robot, 3] += sign * (way[3] - way[1] * x + way[0] * y)
    return matrix[:, :-1, : 3 + turning].reshape(len(matrix), -1)


def test_robots_walked_where_their_flips_say(towers, logs):
    """Summed backward from the end, a walk goes through its every true center."""
    for history, log in zip(towers, logs, strict=True):
        back = displacements(log, log.stances)
        true = [walk.center[:-1] - walk.center[-1] for walk in history.walks]

        np.testing.assert_allclose(back, np.concatenate(true), atol=1e-10)


def test_equations_are_the_derivative_of_what_is_sensed(towers, logs):
    """Central differences of the sensed quantities give the same numbers, turns included."""
    log, position = logs[0], towers[0].position
    matrix = _matrix(position, log, CUES, turning=True)
    rng = np.random.default_rng(0)

    for _ in range(5):
        motion = rng.normal(size=(log.robot_count, 4))
        step, yaw = 1e-6 * motion[:, :3], 1e-6 * motion[:, 3]
        ahead, behind = _sensed(position + step, yaw, log), _sensed(position - step, -yaw, log)
        np.testing.assert_allclose(matrix @ motion.ravel(), (ahead - behind) / 2e-6, atol=1e-6)


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize(
    "cues",
    [
        *(cues for size in (1, 2, 3) for cues in itertools.combinations(CUES[:4], size)),
        ("height", "odometry"),
        ("contacts", "odometry"),
    ],
)
def test_floppy_modes_are_the_null_space(towers, logs, cues, turning):
    """Welding, peeling, factors and probes find what singular values of the whole matrix say.

    But for a turn of the whole swarm about the anchor, which has no part in a motion seen from a
    mean robot.
    """
    for history, log in zip(towers, logs, strict=True):
        matrix = _matrix(history.position, log, cues, turning=turning)
        _, size, ways = np.linalg.svd(matrix)
        null = ways[np.count_nonzero(size > 1e-5) :].reshape(-1, log.robot_count, 3 + turning)
        swings = turning and "odometry" not in cues
        if swings:
            x, y, _ = (history.position - history.position[0]).T
            mean = null[:, :, 3:].mean(axis=1)
            null[:, :, 0] += mean * y
            null[:, :, 1] -= mean * x
        share = np.sqrt((null[:, :, :3] ** 2).sum(axis=(0, 2)) / 3.0)

        bodies = weld(equations(history.position, log, cues, turning=turning))
        marked = loose(bodies)

        assert floppy_modes(bodies) == len(null) - swings
        assert not marked[0]
        clear = (share < HELD / 2) | (share > 2 * HELD)  # 16 probes tell shares to some 15 %
        assert (marked == (share > HELD))[clear].all()


def test_what_is_too_large_to_factor_is_counted_as_far_as_peeling_goes(logs, monkeypatch):
    """Contacts alone peel off to the anchor; what does not is owned to be unknown."""
    exact = observability(logs[0], ["contacts"])

    monkeypatch.setattr(rigidity, "MOST_UNKNOWNS", 0)
    peeled = observability(logs[0], ["contacts"])
    monkeypatch.setattr(rigidity, "MOST_UNKNOWNS", -1)
    unknown = observability(logs[0], ["contacts"])

    assert peeled.floppy_modes == exact.floppy_modes
    assert unknown.floppy_modes is None
    assert peeled.loose is unknown.loose is None
    assert set(peeled.known) == {""}


def test_each_cue_leaves_fewer_motions(logs):
    """Cues can only take freedom away, and knowing one's start takes it all."""
    for log in logs:
        modes = [known.floppy_modes for known in by_cue(log)]

        assert len(modes) == len(CUES)
        assert modes == sorted(modes, reverse=True)
        assert modes[0] > modes[1] > modes[2] > modes[3] >= modes[4] == 0


def test_a_stated_bias_makes_yaw_unknown(towers, logs):
    """There is more to be known then; only a start tells how the swarm as a whole is turned."""
    for history, log in zip(towers, logs, strict=True):
        biased = observe(history, SensingParams(spawn_noise=0.0, yaw_bias_deg=9.0))
        known, found = list(by_cue(log)), list(by_cue(biased))

        assert [entry.turning for entry in found] == [True] * len(CUES) + [False]
        for one, other in zip(known, found, strict=False):
            assert (one.unknowns, other.unknowns) == (3 * 29, 4 * 29)
            assert other.floppy_modes >= one.floppy_modes
            assert one.swing is None
        swings = [entry.swing for entry in found]
        assert swings == pytest.approx([np.radians(9.0) / 30**0.5] * 4 + [None] * 2)
        assert found[-2].known == ["yes"] * 30


def test_robots_are_told_apart_by_what_is_known_of_them(logs):
    """Without contacts all are apart; with an unknown start some are loose; else all are known."""
    robots = logs[0].robot_count

    assert observability(logs[0], ["height"]).known == ["yes"] + ["apart"] * (robots - 1)
    assert set(observability(logs[0], ["contacts", "height"]).known) == {"yes", "loose"}
    assert observability(logs[0], CUES).known == ["yes"] * robots
    assert observability(logs[0], ["contacts"]).floppy_modes >= 3 * (robots - 1) - len(
        logs[0].contacts
    )
