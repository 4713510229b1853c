"""Forces in a structure are what statics, a frame package and the published truss say."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests import frames, oracle_frames
from tests.frames import BODY, Standing
from tiswarm.base.robot import SHAPES, RobotGeometry
from tiswarm.world import mechanics
from tiswarm.world.mechanics import Frames, MechanicsParams, StructureFailure, stiffness

FORCES = ("sensed", "contact_stress", "ground_stress", "ground_force")

MODELS = ("flexible", "rigid")


def _vector(rng, length):
    vector = rng.normal(size=3)
    return length * vector / np.linalg.norm(vector)


def _random_structure(seed, body=BODY):
    """Two to six robots that hang together by beams 1.5 to 2.5 R long, on one to four feet."""
    rng = np.random.default_rng(seed)
    robots = int(rng.integers(2, 7))
    turn = Rotation.random(robots, rng).as_matrix()
    arm, n = body @ turn.swapaxes(1, 2), len(body)
    center = np.zeros((robots, 3))
    contacts = set()
    for j in range(1, robots):
        i, a, b = int(rng.integers(j)), int(rng.integers(n)), int(rng.integers(n))
        center[j] = center[i] + arm[i, a] + _vector(rng, rng.uniform(1.5, 2.5)) - arm[j, b]
        contacts.add((n * i + a, n * j + b))
    dock = (center[:, None] + arm).reshape(-1, 3)
    distance = np.linalg.norm(dock[:, None] - dock[None], axis=2)
    for one, other in np.argwhere((distance > 1.5) & (distance < 2.5)):
        if one // n < other // n:
            contacts.add((int(one), int(other)))
    standing = np.sort(rng.choice(n * robots, int(rng.integers(1, 5)), replace=False))
    foot = np.array([dock[d] + _vector(rng, rng.uniform(1.5, 2.5)) for d in standing])
    ordered = sorted(contacts, key=lambda pair: (pair[1] // n, pair))
    return Standing(
        center=center,
        turn=turn,
        contacts=np.array(ordered),
        standing=standing,
        foot=foot,
        body=body,
    )


def _difference(actual, expected):
    """Greatest difference, relative to the greatest value."""
    return np.abs(actual - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("seed", range(50))
def test_forces_are_those_of_a_frame_package(seed):
    """Robots, contacts and feet at random, built beam by beam in PyNite."""
    structure = _random_structure(seed)

    actual = frames.solve(structure)

    expected = oracle_frames.beam_frame(structure, MechanicsParams())
    for name in FORCES:
        # Both solve in float64; they differ by some 1e-12, and by all of it in a wrong sign.
        assert _difference(getattr(actual, name), getattr(expected, name)) < 1e-9, name


@pytest.mark.parametrize("seed", range(10))
def test_loads_of_contacts_are_those_of_a_frame_package(seed):
    """Pull, shear, bending and torsion, halfway between docks and where docks stand."""
    structure = _random_structure(seed)

    ends, loads = frames.solved(structure, MechanicsParams()).contact_loads(0)

    expected = oracle_frames.beam_frame(structure, MechanicsParams()).section
    feet = np.column_stack([structure.standing, np.full(len(structure.standing), -1)])
    rows = map(tuple, np.concatenate([structure.contacts, feet]).tolist())
    section = dict(zip(rows, expected, strict=True))
    actual = np.column_stack(loads[:4])
    for column in range(4):
        told = np.array([section[row][column] for row in map(tuple, ends.tolist())])
        assert _difference(actual[:, column], told) < 1e-9, loads._fields[column]


@pytest.mark.parametrize("shape", [name for name in SHAPES if name != "triangle"])
@pytest.mark.parametrize("seed", range(3))
def test_robots_of_any_shape_bear_what_a_frame_package_says(shape, seed):
    """From two links to eight, in line, in a plane and in space."""
    structure = _random_structure(seed, RobotGeometry(shape=shape, rho=1.8).dock_offset_body)

    actual = frames.solve(structure)

    expected = oracle_frames.beam_frame(structure, MechanicsParams())
    for name in FORCES:
        assert _difference(getattr(actual, name), getattr(expected, name)) < 1e-9, name


def test_other_beams_than_the_usual_agree_too():
    """Every number of `MechanicsParams` means to PyNite what it means here."""
    structure = _random_structure(50)
    params = MechanicsParams(link_axial=3e7, contact_axial=5e6, beam_radius=0.2, poisson=0.1)

    actual = frames.solve(structure, params)

    expected = oracle_frames.beam_frame(structure, params)
    for name in FORCES:
        assert _difference(getattr(actual, name), getattr(expected, name)) < 1e-9, name


def _some(towers, cantilevers, bridges):
    """The first 12 robots of structures that grew: small enough for dense matrices."""
    return [frames.grown(history, 12) for history in (*towers, *cantilevers, *bridges)]


def test_the_ground_bears_the_published_truss(towers, cantilevers, bridges):
    """The oracle is in balance itself."""
    for structure in _some(towers, cantilevers, bridges):
        forces = oracle_frames.truss(structure, 0.1).ground_force.sum(axis=0)

        # Small tetrahedra hardly resist twisting: rounding costs up to 2e-7.
        weight = 3.0 * len(structure.center)
        np.testing.assert_allclose(forces, [0.0, 0.0, weight], atol=1e-5)


def test_a_frame_of_bars_feels_what_the_published_truss_does(
    towers, cantilevers, bridges, monkeypatch
):
    """With bundles of 16 bars for beams, four rigid nodes a robot stand for its 16 pins."""

    def bars(span, axial, _radius, _poisson):
        return oracle_frames.bundle(span, axial, 0.1)

    monkeypatch.setattr(mechanics, "stiffness", bars)
    for structure in _some(towers, cantilevers, bridges):
        actual = frames.solve(structure).sensed

        # 0.4 to 2.8 %, in part because spheres give, in part because tetrahedra in a link are
        # turned as the robot is, those of the oracle as the world is, and so twist otherwise.
        expected = oracle_frames.truss(structure, 0.1).sensed
        assert np.linalg.norm(actual - expected) < 0.05 * np.linalg.norm(expected)


def test_round_beams_stand_for_tetrahedra_of_seven_tenths(towers, cantilevers, bridges):
    """Beams of radius 0.5 bend and twist about as bundles of bars 0.7 R wide do."""
    for structure in _some(towers, cantilevers, bridges):
        actual = frames.solve(structure).sensed

        # No beam is a bundle of bars: its ends bend each other, those of a bundle do not. The
        # means differ by 2 to 7 %, correlations are 0.97 to 0.99.
        expected = oracle_frames.truss(structure, 0.7).sensed
        assert actual.mean() == pytest.approx(expected.mean(), rel=0.12)
        assert np.corrcoef(actual, expected)[0, 1] > 0.97


@pytest.mark.parametrize("model", MODELS)
def test_the_ground_bears_all_weight_and_nothing_else(towers, cantilevers, bridges, chains, model):
    """Ground forces of grown structures add up to one a dock, straight up."""
    for history in (*towers, *cantilevers, *bridges, *chains):
        for robots in {1, 2, min(10, history.robot_count), history.robot_count}:
            loads = frames.solve(frames.grown(history, robots), model=model)

            total = loads.ground_force.sum(axis=0) / (3 * robots)
            # Rounding leaves 1e-12; 1e-8 leaves room for structures that are less stiff.
            np.testing.assert_allclose(total, [0.0, 0.0, 1.0], atol=1e-8)
            assert loads.imbalance == pytest.approx(abs(total - [0, 0, 1]).max(), abs=1e-15)


def test_stiffness_of_everything_together_changes_no_force():
    """Structures a thousand times softer bear the same."""
    soft = MechanicsParams(link_axial=2e6, contact_axial=1e7)
    for seed in range(5):
        structure = _random_structure(seed)
        for model in MODELS:
            loads = frames.solve(structure, model=model)
            softer = frames.solve(structure, dataclasses.replace(soft, model=model))

            for name in FORCES:
                assert _difference(getattr(softer, name), getattr(loads, name)) < 1e-9, name


@pytest.mark.parametrize("model", MODELS)
def test_a_structure_turned_about_the_vertical_bears_the_same(towers, cantilevers, model):
    """Ground forces turn with it, stresses and what robots sense stay."""
    turn = Rotation.from_euler("z", 1.1).as_matrix()
    for history in (*towers, *cantilevers):
        structure = frames.grown(history)
        turned = Standing(
            center=structure.center @ turn.T + [3.0, -7.0, 0.0],
            turn=turn @ structure.turn,
            contacts=structure.contacts,
            standing=structure.standing,
            foot=structure.foot @ turn.T + [3.0, -7.0, 0.0],
        )

        before, after = (frames.solve(s, model=model) for s in (structure, turned))

        assert _difference(after.ground_force, before.ground_force @ turn.T) < 1e-9
        for name in ("sensed", "contact_stress", "ground_stress"):
            assert _difference(getattr(after, name), getattr(before, name)) < 1e-9, name


@pytest.mark.parametrize("model", MODELS)
def test_structures_that_do_not_touch_do_not_feel_each_other(model):
    """Two in one frame bear what each bears alone."""
    one, other = _random_structure(1), _random_structure(2)
    shift, aside = len(one.dock), np.array([100.0, 0.0, 0.0])
    both = Standing(
        center=np.concatenate([one.center, other.center + aside]),
        turn=np.concatenate([one.turn, other.turn]),
        contacts=np.concatenate([one.contacts, other.contacts + shift]),
        standing=np.concatenate([one.standing, other.standing + shift]),
        foot=np.concatenate([one.foot, other.foot + aside]),
    )

    together = frames.solve(both, model=model)

    alone = [frames.solve(s, model=model) for s in (one, other)]
    for name in FORCES:
        expected = np.concatenate([getattr(loads, name) for loads in alone])
        assert _difference(getattr(together, name), expected) < 1e-9, name


def _upright(tilt):
    """A robot on its dock 0, its plane at an angle from the ground, on a foot 1 R below."""
    turn = Rotation.from_euler("y", tilt).as_matrix()
    dock = turn @ BODY[0]
    return Standing(
        center=np.zeros((1, 3)),
        turn=turn[None],
        contacts=np.empty((0, 2), np.int32),
        standing=np.array([0]),
        foot=(dock - [0.0, 0.0, 1.0])[None],
    )


@pytest.mark.parametrize("model", MODELS)
def test_a_robot_on_one_dock_feels_what_it_weighs(model):
    """Upright it is pressed, lying it is bent; forces by hand."""
    upright = frames.solve(_upright(0.5 * np.pi), model=model)
    lying = frames.solve(_upright(0.0), model=model)

    # Two docks press on the link below, and each pulls or presses its own by cos 60 degrees.
    assert upright.sensed[0] == pytest.approx((2.0 + 0.5 + 0.5) / 3.0, abs=1e-9)
    # Three weights, a center's distance beside the foot, bend the dock that stands.
    assert lying.sensed[0] == pytest.approx(3.0 * 1.506 / 3.0, abs=1e-9)


def test_stress_at_a_foot_is_the_textbook_cantilevers():
    """Weight over area, and moment over the section modulus pi r^3 / 4."""
    radius = 0.5

    stress = frames.solve(_upright(0.0)).ground_stress[0]

    pressed, bent = 3.0 / (np.pi * radius**2), 3.0 * 1.506 / (0.25 * np.pi * radius**3)
    assert stress == pytest.approx(pressed + bent, rel=1e-9)


LENGTH, AXIAL, RADIUS, POISSON = 3.0, 8e3, 0.4, 0.25
BENDING = AXIAL * RADIUS**2 / 4.0
TORSION = BENDING / (1.0 + POISSON)


@pytest.mark.parametrize(
    ("load", "movement"),
    [
        ("fx", {"ux": LENGTH / AXIAL}),
        ("fy", {"uy": LENGTH**3 / (3.0 * BENDING), "rz": LENGTH**2 / (2.0 * BENDING)}),
        ("fz", {"uz": LENGTH**3 / (3.0 * BENDING), "ry": -(LENGTH**2) / (2.0 * BENDING)}),
        ("mx", {"rx": LENGTH / TORSION}),
        ("my", {"uz": -(LENGTH**2) / (2.0 * BENDING), "ry": LENGTH / BENDING}),
        ("mz", {"uy": LENGTH**2 / (2.0 * BENDING), "rz": LENGTH / BENDING}),
    ],
)
def test_a_beam_moves_as_the_textbook_says(load, movement):
    """One end clamped, a unit force or moment on the other, in a frame that is turned."""
    loads, moves = ("fx", "fy", "fz", "mx", "my", "mz"), ("ux", "uy", "uz", "rx", "ry", "rz")
    turn = Rotation.from_euler("zyx", [0.7, -0.4, 1.9]).as_matrix()
    both = np.kron(np.eye(2), turn)
    span = (turn @ [LENGTH, 0.0, 0.0])[None]

    free_end = stiffness(span, AXIAL, RADIUS, POISSON)[0][6:, 6:]
    moved = both.T @ np.linalg.solve(free_end, both @ [name == load for name in loads])

    np.testing.assert_allclose(moved, [movement.get(name, 0.0) for name in moves], atol=1e-12)


def _other_order(structure, order):
    """The same structure with its robots joining in another order, feet and contacts along."""
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    renumbered = 3 * rank[structure.contacts // 3] + structure.contacts % 3
    contacts = np.sort(renumbered, axis=1)
    standing = 3 * rank[structure.standing // 3] + structure.standing % 3
    by_joiner = np.argsort(contacts[:, 1] // 3, kind="stable")
    by_stander = np.argsort(standing // 3, kind="stable")
    shuffled = Standing(
        center=structure.center[order],
        turn=structure.turn[order],
        contacts=contacts[by_joiner],
        standing=standing[by_stander],
        foot=structure.foot[by_stander],
    )
    return shuffled, by_joiner, by_stander


@pytest.mark.parametrize("model", MODELS)
def test_the_order_of_joining_does_not_matter(towers, cantilevers, model):
    """A frame that robots join in any order bears the same."""
    rng = np.random.default_rng(7)
    for history in (*towers, *cantilevers):
        structure = frames.grown(history)
        order = rng.permutation(history.robot_count)
        shuffled, by_joiner, by_stander = _other_order(structure, order)

        first, second = (frames.solve(s, model=model) for s in (structure, shuffled))

        assert _difference(second.sensed, first.sensed[order]) < 1e-9
        assert _difference(second.contact_stress, first.contact_stress[by_joiner]) < 1e-9
        assert _difference(second.ground_force, first.ground_force[by_stander]) < 1e-9


@pytest.mark.parametrize("model", MODELS)
def test_solving_on_the_way_changes_nothing(cantilevers, model):
    """A frame solved after every join bears at each what one built anew does."""
    structure = frames.grown(cantilevers[0])
    growing = Frames(MechanicsParams(model=model), docks=3, robots=30)
    for count in range(1, 31):
        frames.join(growing, 0, structure, count - 1)
        growing.solve([0])
        loads = growing.loads(0)

        anew = frames.solve(frames.grown(cantilevers[0], count), model=model)
        for name in FORCES:
            expected = getattr(anew, name)
            assert np.abs(getattr(loads, name) - expected).max(initial=0.0) < 1e-9 * 90, name


@frames.needs_metis
@pytest.mark.parametrize("leaf", [0, 3])
@pytest.mark.parametrize("model", MODELS)
def test_the_order_of_elimination_changes_no_force(towers, bridges, monkeypatch, model, leaf):
    """METIS orders all nodes of a structure, or those that are left without its leaves."""
    monkeypatch.setattr(mechanics, "_LEAF", leaf)
    for structure in map(frames.grown, (*towers, *bridges)):
        expected = frames.solve(structure, model=model)

        loads = frames.solve(structure, model=model, order="nested-dissection")

        for name in FORCES:
            assert _difference(getattr(loads, name), getattr(expected, name)) < 1e-9, name


@frames.needs_metis
def test_an_order_of_all_structures_is_that_of_each(towers):
    """Structures side by side, of different sizes, are put in order one by one."""
    params = MechanicsParams(order="nested-dissection")
    structures = [frames.grown(history, 10 + 5 * n) for n, history in enumerate(towers)]
    together = Frames(params, docks=3, robots=30, structures=len(structures))
    for number, structure in enumerate(structures):
        for j in range(len(structure.center)):
            frames.join(together, number, structure, j)

    together.solve(range(len(structures)))

    for number, structure in enumerate(structures):
        alone = frames.solve(structure, params)
        np.testing.assert_array_equal(together.loads(number).sensed, alone.sensed)


def test_robots_sense_what_a_frame_built_anew_says(towers, cantilevers, bridges, chains):
    """Growth hands on what its mechanics found, robot by robot."""
    for history in (*towers, *cantilevers, *bridges, *chains):
        loads = frames.solve(frames.grown(history))

        assert _difference(history.sensed, loads.sensed) < 1e-9
        assert history.loads[-1].peak == pytest.approx(loads.peak, rel=1e-9)
        assert history.loads[-1].sensed_max == pytest.approx(loads.sensed.max(), rel=1e-9)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(
    "order", ["minimum-degree", pytest.param("nested-dissection", marks=frames.needs_metis)]
)
def test_what_nothing_holds_is_a_failure(model, seed, order):
    """Rounding hides that such a structure's matrix is singular, as it often does."""
    rng = np.random.default_rng(seed)
    held = _random_structure(seed)
    floating = dataclasses.replace(held, standing=held.standing[:0], foot=held.foot[:0])
    beside = dataclasses.replace(
        held,
        center=np.concatenate([held.center, [[50.0, 0.0, 0.0]]]),
        turn=np.concatenate([held.turn, Rotation.random(1, rng).as_matrix()]),
    )

    for structure in (floating, beside):
        with pytest.raises(StructureFailure, match="held by nothing"):
            frames.solve(structure, model=model, order=order)


def test_rigid_robots_are_the_limit_of_stiff_ones(towers, cantilevers):
    """With links a million times stiffer than contacts the two models agree."""
    for history in (*towers, *cantilevers):
        structure = frames.grown(history)

        rigid = frames.solve(structure, model="rigid")
        stiff = frames.solve(structure, link_axial=1e16)

        for name in FORCES:
            # A link gives a millionth of what a contact does, which moves forces by up to 1e-5.
            assert _difference(getattr(stiff, name), getattr(rigid, name)) < 1e-4, name


def test_rigid_robots_call_for_help_mostly_where_flexible_ones_do(towers, cantilevers, bridges):
    """Both models put most robots on the same side of F, for the usual values of F."""
    histories = (*towers, *cantilevers, *bridges)
    flexible = np.concatenate([frames.solve(frames.grown(h)).sensed for h in histories])
    rigid = np.concatenate([frames.solve(frames.grown(h), model="rigid").sensed for h in histories])

    for force in (2.5, 5.0, 10.0, 25.0):
        # 85 % at F = 2.5 to 97 % at F = 25: the choice is one of speed.
        assert np.mean((rigid >= force) == (flexible >= force)) > 0.8
