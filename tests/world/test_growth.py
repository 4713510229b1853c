"""Structures grow by the rules, soundly, and the same way every time."""

import dataclasses

import numpy as np
import pytest

from tests import oracle
from tiswarm.compute import backend
from tiswarm.robot import TANGENT_RHO, RobotGeometry
from tiswarm.world.growth import grow
from tiswarm.world.history import History
from tiswarm.world.params import ClimbParams, TowerParams
from tiswarm.world.soundness import unsoundness

FIREANT = RobotGeometry()


def _same(a: History, b: History) -> bool:
    return all(
        np.array_equal(getattr(x, field.name), getattr(y, field.name))
        for x, y in zip(a.walks, b.walks, strict=True)
        for field in dataclasses.fields(x)
    )


def test_towers_are_sound_and_touch_where_they_say(towers):
    """No overlap beyond 1e-9 R, and exactly the contacts that the final places imply."""
    for history in towers:
        docks = np.array(
            [
                center + FIREANT.dock_offset_body @ oracle.matrix(q).T
                for center, q in zip(history.position, history.orientation_wxyz, strict=True)
            ]
        )
        felt = {tuple(row) for row in history.contacts}
        for j in range(history.robot_count):
            for i in range(j):
                distance = np.linalg.norm(docks[i][:, None] - docks[j][None], axis=2)
                assert distance.min() > 2.0 - 1e-9
                for a, b in np.argwhere(distance < 2.02):
                    assert (i, a, j, b) in felt
                    felt.discard((i, a, j, b))

        assert not felt
        assert unsoundness(history, contact_gap=0.02) == ""


def test_every_robot_but_the_first_touches_an_earlier_one(towers):
    """A robot that ends alone is spawned again."""
    for history in towers:
        assert set(history.contacts[:, 2]) == set(range(1, history.robot_count))
        assert history.spawns >= history.robot_count


def test_robots_stay_at_the_best_stance_of_their_walk(towers):
    """The last stance is the one nearest to the goal, and the way there is out and back."""
    goal = np.array([0.0, 0.0, TowerParams().goal_height])
    for history in towers:
        for walk in history.walks:
            distance = np.linalg.norm(walk.center - goal, axis=1)

            assert distance[-1] == distance.min()


def test_towers_climb():
    """Robots go up: a mast of 30 robots is much taller than wide."""
    history = grow(TowerParams(), robots=30, seeds=[5], robot=FIREANT)[0]

    assert history.position[:, 2].max() > 15.0


def test_company_does_not_change_a_structure():
    """A seed grows the same structure alone, in a batch, on one thread and on two."""
    alone = grow(TowerParams(), robots=12, seeds=[3], robot=FIREANT)[0]
    batch = grow(TowerParams(), robots=12, seeds=[1, 3, 2], robot=FIREANT)
    backend.start(threads=1)
    single = grow(TowerParams(), robots=12, seeds=[1, 3, 2], robot=FIREANT)

    assert _same(alone, batch[1])
    assert all(_same(a, b) for a, b in zip(batch, single, strict=True))
    assert not _same(batch[0], batch[2])


def test_tangent_robots_grow_too():
    """With rho = 2 / sqrt(3) a robot's own docks touch, and growth still works."""
    robot = RobotGeometry(rho=TANGENT_RHO)

    history = grow(TowerParams(), robots=12, seeds=[0], robot=robot)[0]

    assert history.robot_count == 12
    assert unsoundness(history, contact_gap=0.02) == ""


def test_growth_that_cannot_go_on_says_why_and_keeps_what_it_has():
    """Robots spawned far out with a short walk never arrive."""
    params = TowerParams(
        spawn_min=200.0, spawn_max=210.0, climb=ClimbParams(max_flips=3, max_spawns=4)
    )

    history = grow(params, robots=5, seeds=[0], robot=FIREANT)[0]

    assert history.robot_count == 1
    assert "max_spawns" in history.ended


def _moved(history: History, j: int, by: np.ndarray) -> History:
    walk = history.walks[j]
    moved = dataclasses.replace(walk, center=walk.center + by)
    return dataclasses.replace(history, walks=(*history.walks[:j], moved, *history.walks[j + 1 :]))


@pytest.mark.parametrize(
    ("by", "fault"),
    [
        ([0.0, 0.0, -50.0], "deep in the ground"),
        ([30.0, 0.0, 0.0], "in contact"),
        ([1e-3, 1e-3, 0.0], "overlap"),
    ],
)
def test_unsound_structures_are_found_out(towers, by, fault):
    """A robot pushed into the ground, torn off, or pressed into its neighbours."""
    faults = [
        unsoundness(_moved(towers[0], j, sign * np.array(by)), contact_gap=0.02)
        for j in (10, 20)
        for sign in (1, -1)
    ]

    assert any(fault in found for found in faults)


def test_a_robot_held_by_nothing_is_found_out(towers):
    """A walk that ends without a contact cannot stay where it is."""
    walk = towers[0].walks[-1]
    loose = dataclasses.replace(
        walk, contacts=walk.contacts[:0], ground_docks=walk.ground_docks[:0]
    )
    history = dataclasses.replace(towers[0], walks=(*towers[0].walks[:-1], loose))

    assert "held by nothing" in unsoundness(history, contact_gap=0.02)
