"""The count of floppy modes is what moving the robots shows."""

import itertools

import numpy as np
import pytest

from tiswarm.compute.rotations import dock_offsets
from tiswarm.records import freedom
from tiswarm.records.certainty import by_cue, certainty
from tiswarm.records.freedom import HELD, floppy_modes, loose, weld
from tiswarm.records.rigidity import equations
from tiswarm.records.walks import displacements
from tiswarm.sensing import SensingParams, observe

CUES = ("contacts", "ground", "height", "walk_contacts", "odometry")


@pytest.fixture(scope="module")
def logs(towers):
    """What the robots of each tower sensed, their spawns included."""
    return [observe(history, SensingParams(spawn_noise=0.0)) for history in towers]


def _sensed(position, log):
    """Every distance of docks in contact now or once, every height and place, dock by dock."""
    turned = dock_offsets(log.orientation_wxyz, log.dock_offset_body)
    distance = [
        np.linalg.norm(position[i] + turned[i, a] - position[j] - turned[j, b])
        for i, a, j, b in log.contacts
    ]
    stances = log.stances
    then = dock_offsets(stances.orientation_wxyz, log.dock_offset_body)
    back = displacements(log, stances)
    for row, own, i, a in stances.contacts:
        j = np.searchsorted(stances.start, row, side="right") - 1
        dock = position[j] + back[row] + then[row, own]
        distance.append(np.linalg.norm(dock - position[i] - turned[i, a]))
    ground = [position[j, 2] + turned[j, own, 2] for j, own in log.ground_docks]
    for row, _ in stances.ground_docks:
        ground.append(position[np.searchsorted(stances.start, row, side="right") - 1, 2])
    return np.r_[distance, ground, position[:, 2], position.ravel()]


def _matrix(position, log, cues):
    """Rigidity matrix of all robots but the anchor, row by row."""
    known = equations(position, log, cues)
    matrix = np.zeros((len(known.unit), log.robot_count, 3))
    for row, (i, j, unit) in enumerate(zip(*known, strict=True)):
        matrix[row, j] += unit
        matrix[row, i] -= unit
    return matrix[:, 1:].reshape(len(matrix), -1)


def test_robots_walked_where_their_flips_say(towers, logs):
    """Summed backward from the end, a walk goes through its every true center."""
    for history, log in zip(towers, logs, strict=True):
        back = displacements(log, log.stances)
        true = [walk.center[:-1] - walk.center[-1] for walk in history.walks]

        np.testing.assert_allclose(back, np.concatenate(true), atol=1e-10)


def test_equations_are_the_derivative_of_what_is_sensed(towers, logs):
    """Central differences of the sensed quantities give the same numbers."""
    log, position = logs[0], towers[0].position
    matrix = _matrix(position, log, CUES)
    rng = np.random.default_rng(0)

    for _ in range(5):
        motion = rng.normal(size=position.shape)
        motion[0] = 0.0
        step = 1e-6 * motion
        slope = (_sensed(position + step, log) - _sensed(position - step, log)) / 2e-6
        np.testing.assert_allclose(matrix @ motion[1:].ravel(), slope, atol=1e-6)


@pytest.mark.parametrize(
    "cues", [cues for size in (1, 2, 3) for cues in itertools.combinations(CUES[:4], size)]
)
def test_floppy_modes_are_the_null_space(towers, logs, cues):
    """Welding, peeling, factors and probes find what singular values of the whole matrix say."""
    for history, log in zip(towers, logs, strict=True):
        matrix = _matrix(history.position, log, cues)
        _, size, ways = np.linalg.svd(matrix)
        null = ways[np.count_nonzero(size > 1e-5) :]
        share = np.sqrt((null.reshape(len(null), -1, 3) ** 2).sum(axis=(0, 2)) / 3.0)

        bodies = weld(equations(history.position, log, cues), log.robot_count)
        marked = loose(bodies)

        assert floppy_modes(bodies) == len(null)
        assert not marked[0]
        clear = (share < HELD / 2) | (share > 2 * HELD)  # 16 probes tell shares to some 15 %
        assert (marked[1:] == (share > HELD))[clear].all()


def test_what_is_too_large_to_factor_is_counted_as_far_as_peeling_goes(logs, monkeypatch):
    """Contacts alone peel off to the anchor; what does not is owned to be unknown."""
    exact = certainty(logs[0], ["contacts"])

    monkeypatch.setattr(freedom, "MOST_BODIES", 1)
    peeled = certainty(logs[0], ["contacts"])
    monkeypatch.setattr(freedom, "MOST_BODIES", 0)
    unknown = certainty(logs[0], ["contacts"])

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


def test_robots_are_told_apart_by_what_is_known_of_them(logs):
    """Without contacts all are apart; with an unknown start some are loose; else all are known."""
    robots = logs[0].robot_count

    assert certainty(logs[0], ["height"]).known == ["yes"] + ["apart"] * (robots - 1)
    assert set(certainty(logs[0], ["contacts", "height"]).known) == {"yes", "loose"}
    assert certainty(logs[0], CUES).known == ["yes"] * robots
    assert certainty(logs[0], ["contacts"]).floppy_modes >= 3 * (robots - 1) - len(logs[0].contacts)
