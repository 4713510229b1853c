"""The count of floppy modes is what moving the robots shows."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.structures import Rule, structure
from tiswarm.compute.math import dock_offsets
from tiswarm.measurements import cues as cues_module
from tiswarm.measurements import rigidity
from tiswarm.measurements.contacts import hops
from tiswarm.measurements.cues import measure
from tiswarm.measurements.observability import by_cue, common_modes, observability
from tiswarm.measurements.odometry import displacements
from tiswarm.measurements.rigidity import SHIFTED, FloppyMotions, weld
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
    stances = log.stances
    then = dock_offsets(stances.orientation_wxyz, log.dock_offset_body)
    back = displacements(log, stances)
    owner = [int(np.searchsorted(stances.start, row, "right")) - 1 for row in range(len(then))]
    contacts = [(j, np.diff(stances.start)[j], b, i, a) for i, a, j, b in log.contacts]
    for row, own, i, a in stances.contacts:
        j = owner[row]
        stays = own == stances.pivot_dock[row]  # and says the same thing at the next stance
        following = (j, row - stances.start[j] + 1, own, i, a)
        again = row + 1 < len(then) and owner[row + 1] == j
        known = (
            [row + 1, own, i, a] in stances.contacts.tolist()
            if again
            else ([i, a, j, own] in log.contacts.tolist())
        )
        if not (stays and known):
            contacts.append((*following[:1], following[1] - 1, *following[2:]))
    distance = []
    for j, stance, own, i, a in sorted(contacts):
        row = stances.start[j] + stance
        final = row == stances.start[j + 1]
        arm = turned[j, own] if final else back[row] + then[row, own]
        dock = position[j] + turn[j] @ arm
        distance.append(np.linalg.norm(dock - position[i] - turn[i] @ turned[i, a]))
    first = stances.start[:-1] + np.arange(log.robot_count)  # among all stances, final ones too
    final = first + np.diff(stances.start)
    places = [(final[j], own, 2, position[j, 2] + turned[j, own, 2]) for j, own in log.ground_docks]
    stood = {(final[j], own) for j, own in log.ground_docks.tolist()}
    stood |= {(row + owner[row], own) for row, own in stances.ground_docks.tolist()}
    for row, own in stances.ground_docks:
        j = owner[row]
        if own != stances.pivot_dock[row] or (row + j + 1, own) not in stood:
            places.append((row + j, own, 2, position[j, 2] + (back[row] + then[row, own])[2]))
    for j, p in enumerate(position):
        begun = p + turn[j] @ (back[owner.index(j)] if j in owner else 0 * p)
        places += [(first[j], -1, axis, value) for axis, value in enumerate(begun)]
        places.append((first[j], -1, 2, begun[2]))
    return np.r_[distance, [value for *_, value in sorted(places, key=lambda place: place[:3])]]


def _matrix(position, log, cues, *, turning=False):
    """Derivatives of what is sensed by x, y and z, and yaw [dock radius], of every robot."""
    rows = measure(log, cues)
    shift, yaw = np.split(rows.jacobian(position).toarray(), [3 * log.robot_count], axis=1)
    matrix = np.concatenate([shift.reshape(len(rows), -1, 3), yaw[:, :, None]], axis=2)
    anchor = np.zeros((3, log.robot_count, 4))
    anchor[:, 0, :3] = np.eye(3)
    matrix = np.concatenate([matrix, anchor])[:, :, : 3 + turning]
    return matrix.reshape(len(matrix), -1)


def test_robots_walked_where_their_flips_say(towers, logs):
    """Summed backward from the end, a walk goes through its every true center."""
    for history, log in zip(towers, logs, strict=True):
        back = displacements(log, log.stances)
        true = [walk.center[:-1] - walk.center[-1] for walk in history.walks]

        np.testing.assert_allclose(back, np.concatenate(true), atol=1e-10)


def test_equations_are_the_derivative_of_what_is_sensed(towers, logs):
    """Central differences of the sensed quantities give the same numbers, turns included."""
    log, position = logs[0], towers[0].position
    matrix = _matrix(position, log, CUES, turning=True)[:-3]
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

        bodies = weld(measure(log, cues), history.position, yaw_unknown=turning)
        marked = FloppyMotions(bodies).robots()

        assert bodies.floppy_modes == len(null) - swings
        assert not marked[0]
        clear = (share < SHIFTED / 2) | (share > 2 * SHIFTED)  # 16 probes tell shares to some 15 %
        assert (marked == (share > SHIFTED))[clear].all()


def test_what_is_too_large_to_factor_is_counted_as_far_as_peeling_goes(logs, monkeypatch):
    """Contacts alone peel off to the anchor; what does not is owned to be unknown."""
    exact = observability(logs[0], ["contacts"])

    monkeypatch.setattr(rigidity, "MOST_UNKNOWNS", 0)
    peeled = observability(logs[0], ["contacts"])
    monkeypatch.setattr(rigidity, "MOST_UNKNOWNS", -1)
    unknown = observability(logs[0], ["contacts"])

    assert peeled.floppy_modes == exact.floppy_modes
    assert unknown.floppy_modes is None
    assert peeled.floppy is unknown.floppy is None
    assert set(peeled.known) == {""}


def test_walks_are_summed_once_for_all_cues(logs, monkeypatch):
    """They are the same for each cue."""
    summed = []
    walks = cues_module.Odometry
    monkeypatch.setattr(cues_module, "Odometry", lambda *a: summed.append(1) or walks(*a))

    assert len(list(by_cue(logs[0]))) > 2
    assert len(summed) == 1


def test_bodies_with_too_many_loops_are_not_factored(monkeypatch):
    """What is beyond the limit is owned to be unknown."""
    log, _ = structure(Rule(kind="loops"), 60, 0)
    known = observability(log, ["contacts"])
    monkeypatch.setattr(rigidity, "MOST_LOOPS", 0)
    factored = []
    monkeypatch.setattr(rigidity, "factored", lambda *_, **__: factored.append(1))

    unknown = observability(log, ["contacts"])

    assert known.floppy is not None
    assert unknown.floppy is None
    assert not factored


@pytest.mark.parametrize("turning", [False, True])
def test_common_modes_are_those_of_two_bodies(towers, logs, turning):
    """They move and turn all robots tied to the anchor alike; its only dock resists no turn."""
    for tower, log in zip(towers, logs, strict=True):
        of_anchor = log.contacts[log.contacts[:, 0] == 0, 1]
        others = (log.contacts[:, 0] == 0) & (log.contacts[:, 1] != of_anchor[0])
        for each in (log, replace(log, contacts=log.contacts[~others])):
            known = observability(each, ["contacts", "height"], yaw_unknown=turning)
            modes, docks = common_modes(each, known)
            place = tower.position - tower.position[0]
            tied = np.isfinite(hops(each, np.array([0]))[0]) & (np.arange(each.robot_count) > 0)
            body = tied[:, None, None] * np.eye(3 + turning)
            if turning:
                body[tied, :2, 3] = np.column_stack([-place[tied, 1], place[tied, 0]])
            matrix = _matrix(tower.position, each, known.cues, turning=turning)
            rank = np.linalg.matrix_rank(matrix @ body.reshape(-1, 3 + turning), tol=1e-5)

            assert modes == 3 + turning - rank
            assert modes >= turning * (len(docks) == 1)
            assert {*docks} == ({*of_anchor} if each is log else {of_anchor[0]})


def test_cues_without_measurements_are_left_out(logs):
    """A log without heights has no such cue, even if it is in use."""
    bare = replace(
        logs[0], stances=None, ground_docks=logs[0].ground_docks[:0],
        flip_height=np.full(logs[0].robot_count, np.nan),
    )  # fmt: skip

    assert observability(bare, CUES).cues == ("contacts", "odometry")
    assert observability(logs[0], CUES).cues == CUES


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

        assert [entry.yaw_unknown for entry in found] == [True] * len(CUES) + [False]
        for one, other in zip(known, found, strict=False):
            assert (one.unknowns, other.unknowns) == (3 * 29, 4 * 29)
            assert other.floppy_modes >= one.floppy_modes
            assert one.gauge_yaw_sd is None
        swings = [entry.gauge_yaw_sd for entry in found]
        assert swings == pytest.approx([np.radians(9.0) / 30**0.5] * 4 + [None] * 2)
        assert found[-2].known == ["yes"] * 30


def test_robots_are_told_apart_by_what_is_known_of_them(logs):
    """Without contacts all are apart; with an unknown start some are loose; else all are known."""
    robots = logs[0].robot_count

    assert observability(logs[0], ["height"]).known == ["yes"] + ["disconnected"] * (robots - 1)
    assert set(observability(logs[0], ["contacts", "height"]).known) == {"yes", "floppy"}
    assert observability(logs[0], CUES).known == ["yes"] * robots
    assert observability(logs[0], ["contacts"]).floppy_modes >= 3 * (robots - 1) - len(
        logs[0].contacts
    )
