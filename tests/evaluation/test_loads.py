"""The table of loads: what each contact bears, in the units of its strength."""

import dataclasses

import numpy as np
import pytest

import tiswarm
from tests.structures import grown
from tiswarm.base.robot import RobotGeometry
from tiswarm.evaluation.tables import by_contact
from tiswarm.world.mechanics import Frames, MechanicsParams
from tiswarm.world.params import TowerParams
from tiswarm.world.strength import GRAVITY, StrengthParams

ROD = RobotGeometry(docks=((0.0, 0.0, 1.5), (0.0, 0.0, -1.5)))
"""A robot of two docks, one above and one below its center."""


def _hanging_chain(robots, strength):
    """The history of robots that hang straight below each other from a ceiling."""
    frames = Frames(MechanicsParams(), docks=2, robots=robots)
    for robot in range(robots):
        center = np.array([0.0, 0.0, -5.0 * robot])
        docks = center + ROD.dock_offset_body
        contacts = np.array([[2 * robot - 1, 2 * robot]] if robot else np.empty((0, 2)), int)
        on_ceiling = np.array([] if robot else [0], int)
        ceiling = docks[on_ceiling] + np.array([0.0, 0.0, 1.0])
        frames.join(0, center, docks, contacts, on_ceiling, ceiling)
    frames.solve([0])
    ends, loads = frames.contact_loads(0)
    robot, dock = np.divmod(ends, 2)
    dock[ends < 0] = -1
    return dataclasses.replace(
        grown(TowerParams(), robots=2, seed=0),
        robot=ROD,
        loaded_contacts=np.column_stack([robot, dock])[:, [0, 2, 1, 3]].astype(np.int32),
        contact_load=np.column_stack([*loads, strength.used(0, ends, loads, 2)]),
    )


def test_a_chain_hangs_by_the_weight_below_each_contact():
    """Counted by hand: 5 robots of 2 kg hang from the ceiling, 4 from the first robot, ..., 1."""
    strength = StrengthParams(law="tension", limit=200.0, robot_mass_kg=2.0)

    table = by_contact(_hanging_chain(5, strength), strength)

    weight_below = 2.0 * GRAVITY * np.array([5, 4, 3, 2, 1])
    assert table["robot"].tolist() == [0, 1, 2, 3, 4]
    assert table["dock"].tolist() == [0, 0, 0, 0, 0]
    assert table["neighbor"].tolist() == ["ground", "0", "1", "2", "3"]
    assert table["neighbor_dock"].fillna(-1).tolist() == [-1, 1, 1, 1, 1]
    np.testing.assert_allclose(table["axial_N"], weight_below, rtol=1e-9)
    np.testing.assert_allclose(table["margin"], 200.0 / weight_below, rtol=1e-9)
    np.testing.assert_allclose(table[["shear_N", "bending_N_R", "torsion_N_R"]], 0.0, atol=1e-6)


def test_the_stress_of_a_hanging_chain_is_its_weight_over_the_section():
    """By hand, in MPa: the beams of contacts have a radius of half a dock radius, here 15 mm."""
    mass_and_size = {"robot_mass_kg": 2.0, "radius_mm": 30.0}
    strength = StrengthParams(law="von-mises", limit=1.0, **mass_and_size)

    table = by_contact(_hanging_chain(3, strength), strength)

    newtons = 2.0 * GRAVITY * np.array([3, 2, 1])
    square_mm = np.pi * 15.0**2
    np.testing.assert_allclose(table["stress_MPa"], newtons / square_mm, rtol=1e-9)
    np.testing.assert_allclose(table["axial_N"], newtons, rtol=1e-9)


MASS = {"robot_mass_kg": 2.0}
SIZE = {"radius_mm": 30.0}


@pytest.mark.parametrize(
    ("law", "limit", "unit", "column"),
    [
        ("tension", 69.0, {}, "axial_W"),
        ("shear", 60.0, {}, "shear_W"),
        ("bending", 60.0, {}, "bending_W_R"),
        ("von-mises", 400.0, {}, "stress_W_per_R2"),
        ("tension", 400.0, MASS, "axial_N"),
        ("shear", 400.0, MASS, "shear_N"),
        ("bending", 12.0, MASS | SIZE, "bending_N_m"),
        ("von-mises", 3.0, MASS | SIZE, "stress_MPa"),
    ],
)
def test_loads_have_the_unit_of_the_limit(law, limit, unit, column):
    """Margin times load is the limit as the scenario states it, where docks are equally strong."""
    strength = {"law": law, "limit": limit, **unit}
    structures = tiswarm.grow(
        {"kind": "tower", "strength": strength}, robots=12, seeds=[0], quiet=True
    )

    table = structures.load_table

    bears = table["margin"].notna()
    assert bears.any()
    np.testing.assert_allclose((table["margin"] * table[column])[bears], limit, rtol=1e-9)


def test_the_weakest_contact_is_first():
    """Rows ascend by margin; each robot's least one is its margin."""
    tower = {"kind": "tower", "strength": {"limit": 250.0, "scatter": 0.2}}
    structures = tiswarm.grow(tower, robots=20, seeds=[3, 4], quiet=True)

    table = structures.load_table

    assert {*table["seed"]} == {3, 4}
    for number, seed in enumerate((3, 4)):
        rows = table[table["seed"] == seed]
        assert rows["margin"].is_monotonic_increasing
        for robot, margin in enumerate(structures.margin[number].tolist()):
            touches = (rows["robot"] == robot) | (rows["neighbor"] == str(robot))
            assert rows["margin"][touches].iloc[0] == margin
