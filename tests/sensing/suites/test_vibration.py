"""Names by vibration: which contacts robots miss, and whom they take for a neighbor."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tiswarm
from tests.records.test_sensing_file import content
from tiswarm.compute.math import uniform
from tiswarm.records.sensing_file import read_sensing_log, write_sensing_log
from tiswarm.sensing import SensingParams, observe
from tiswarm.sensing.params import Vibration

models = st.builds(
    Vibration,
    slots=st.integers(1, 30),
    hearing=st.integers(1, 5),
    fading=st.sampled_from([0.0, 0.3, 1.0]),
    missed=st.sampled_from([0.0, 0.2, 1.0]),
)


def rows_of(history, vibration, **others):
    """Contacts of all stances as rows of (robot, stance, own dock, other, other dock)."""
    log = observe(history, SensingParams(vibration=vibration, **others))
    robot = np.repeat(np.arange(log.robot_count), np.diff(log.stances.start))
    found = []
    for stance, a, j, b in log.stances.contacts.tolist():
        i = int(robot[stance])
        found.append((i, stance - int(log.stances.start[i]), a, j, b))
    last = np.diff(log.stances.start)
    found += [(i, int(last[i]), a, j, b) for j, b, i, a in log.contacts.tolist()]
    return {*found}


def hops_from(history, robot, stance):
    """Contacts from a robot to each earlier one, by repeated looks at all pairs."""
    left = history.left_after
    there = [k for k in range(robot) if left[k] > robot]
    pairs = {(i, j) for i, _, j, _ in history.contacts_at_join.tolist()}
    hops = {j: 1 for at, _, j, _ in history.walks[robot].contacts.tolist() if at == stance}
    for count in range(2, len(history.walks)):
        new = {
            k for k in there for j in hops
            if k not in hops and hops[j] == count - 1 and ((k, j) in pairs or (j, k) in pairs)
        }  # fmt: skip
        hops |= dict.fromkeys(new, count)
    return hops


def slowly(history, model):
    """Name each contact alone: the robots in its slot, their strengths, one draw."""
    found, docks = set(), len(history.robot.dock_offset_body)
    for i, walk in enumerate(history.walks):
        for stance, a, j, b in walk.contacts.tolist():
            number = ((stance * docks + a) * history.robot_count + j) * docks + b
            draw = uniform(history.seed, "vibration", i, number)
            is_missed = uniform(history.seed, "missed vibration", i, number) < model.missed
            if is_missed or i % model.slots == j % model.slots:
                continue
            heard = {
                k: model.fading ** (hops - 1)
                for k, hops in sorted(hops_from(history, i, stance).items())
                if hops <= model.hearing and k % model.slots == j % model.slots
            }
            names, goal = list(heard), draw * sum(heard.values())
            below = [k for k in range(len(names)) if sum([*heard.values()][: k + 1]) <= goal]
            found.add((i, stance, a, names[len(below)], b))
    return found


@settings(max_examples=12, deadline=None)
@given(model=models)
def test_names_are_those_of_a_slow_program(towers, model):
    """It looks at each contact alone, and at all pairs of robots for each hop."""
    assert rows_of(towers[0], model) == slowly(towers[0], model)


@settings(max_examples=25, deadline=None)
@given(model=models, which=st.integers(0, 2))
def test_laws_of_slots(towers, model, which):
    """Wrong names are those of robots in reach and in the slot of the neighbor, for any model."""
    history = towers[which % len(towers)]
    true, found = rows_of(history, None), rows_of(history, model)
    by_dock = {}
    for i, stance, a, j, b in true:
        by_dock.setdefault((i, stance, a, b), set()).add(j % model.slots)

    for i, stance, a, name, b in found:
        assert name < i
        assert name % model.slots in by_dock[i, stance, a, b]
        assert name % model.slots != i % model.slots
        assert hops_from(history, i, stance)[name] <= model.hearing
    if model.slots >= history.robot_count and not model.missed:
        assert found == true
    if model.missed == 1.0 or model.slots == 1:
        assert not found
    assert rows_of(history, replace(model, missed=1.0)) <= found
    if model.hearing == 1 and model.fading:
        assert found == rows_of(history, replace(model, fading=0.1))  # nothing has faded


def test_wider_hearing_makes_more_wrong_names(towers):
    """Every robot in reach may be in the slot of a neighbor."""
    wrong = [
        sum(len(rows_of(h, Vibration(slots=8, hearing=reach)) - rows_of(h, None)) for h in towers)
        for reach in (1, 3, 9)
    ]

    assert wrong[0] < wrong[1] < wrong[2]


def test_robots_that_fail_still_carry_vibrations(towers):
    """A mute or deaf robot has no contacts of its own; names of other contacts stay the same."""
    model = Vibration(slots=7, hearing=4)
    every, fewer = (rows_of(towers[0], model, **fail) for fail in ({}, {"mute": 0.3, "deaf": 0.3}))

    assert fewer <= every
    assert fewer


def test_the_log_states_missed_vibrations(towers, tmp_path):
    """They are missed contacts, beside those that touch misses; the file has them."""
    params = SensingParams(missed_contacts=0.1, vibration=Vibration(missed=0.2))
    log = observe(towers[0], params)

    write_sensing_log(log, tmp_path / "log")

    assert log.noise.missed_contacts == pytest.approx(0.28)
    assert content(read_sensing_log(tmp_path / "log")) == content(log)


@pytest.mark.parametrize("given", ["slots: 0", "hearing: 0", "missed: 1.5", "slot: 3"])
def test_wrong_settings_are_refused_with_their_line(tmp_path, given):
    """A key that is unknown or out of range is one line."""
    text = f"sensing:\n  vibration:\n    {given}\n"
    text += "name: own\nrobots: 3\nstructure: {kind: tower}\nlocalization: {method: joint}\n"
    (tmp_path / "own.yaml").write_text(text)

    [mistake] = tiswarm.check(tmp_path / "own.yaml").mistakes

    assert "own.yaml:3" in str(mistake)
    assert given.partition(":")[0] in str(mistake)
