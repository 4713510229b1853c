"""The swarm step against the equations written out, and laws that hold for any structure."""

import inspect
from typing import get_type_hints

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tests.oracle import swarm_step
from tiswarm import relax
from tiswarm.base.errors import EnvironmentTroubleError, InputError
from tiswarm.base.robot import Robot, RobotGeometry
from tiswarm.compute import backend, neighbor_list
from tiswarm.engine import relax as engine
from tiswarm.engine import stepping

ROBOT = RobotGeometry()
GAINS = {"attraction_gain": 0.3, "repulsion_gain": 0.1, "max_step": 0.3}


class OneDock:
    """A robot that is one sphere, of another size."""

    spacing = 0.5
    dock_offset_body = np.array([[0.1, 0.0, 0.2]])


def swarm(robots, seed=0, sides=(1.0, 1.0, 1.0), robot=ROBOT):
    """Robots at random in a box, about as dense as a structure; half the touching docks dock."""
    rng = np.random.default_rng(seed)
    docks = len(robot.dock_offset_body)
    volume = robots * docks * robot.spacing**3
    box = np.array(sides) * (volume / np.prod(sides)) ** (1 / 3)
    position = (rng.random((robots, 3)) - 0.5) * box
    orientation = rng.normal(size=(robots, 4))
    orientation /= np.linalg.norm(orientation, axis=1)[:, None]
    arm = arms(orientation, robot)
    near = cKDTree((position[:, None] + arm).reshape(-1, 3)).query_pairs(
        1.05 * robot.spacing, output_type="ndarray"
    )
    near = near[near[:, 0] // docks != near[:, 1] // docks]
    near = near[rng.random(len(near)) < 0.5]
    contacts = np.column_stack(np.divmod(near, docks)).reshape(-1, 4)[:, [0, 2, 1, 3]]
    return position, orientation, contacts


def arms(orientation, robot=ROBOT):
    """Center to dock in the world frame."""
    turn = Rotation.from_quat(orientation, scalar_first=True).as_matrix()
    return np.einsum("nij,kj->nki", turn, robot.dock_offset_body)


@pytest.fixture(params=["by structure", "all at once", "as on a card"])
def _way(request, monkeypatch):
    """All ways in which steps are taken; the processor runs a card's kernels too."""
    monkeypatch.setattr(engine, "SMALL", 2_000 if request.param == "by structure" else 0)
    monkeypatch.setattr(backend.Backend, "on_card", request.param == "as on a card")
    monkeypatch.setattr(stepping, "_STEPS_ON_CARD", 4)  # fewer to compile


@pytest.mark.usefixtures("_way")
@pytest.mark.parametrize("robot", [ROBOT, OneDock()], ids=["three docks", "one dock"])
@pytest.mark.parametrize("sides", [(1, 1, 1), (1, 1, 40), (300, 300, 300)])
def test_steps_are_the_equations(robot, sides):
    """Twelve steps, rows made anew on the way, of two structures in each other's space."""
    position, orientation, contacts = swarm(30, 3, sides, robot)
    structure = np.arange(30) % 2
    contacts = contacts[structure[contacts[:, 0]] == structure[contacts[:, 2]]]
    height = np.where(np.arange(30) % 3, 0.4, np.nan)
    ramp = np.linspace(0.0, 1.0, 12)
    gains = GAINS | {"max_step": 0.15 * robot.spacing, "height_gain": 0.05}

    result = relax(
        position, orientation, contacts, robot=robot, ramp=ramp, steps=12,
        height=height, structure=structure, **gains,
    )  # fmt: skip

    expected, moves = position, []
    for alpha in ramp:
        moved = swarm_step(
            expected, arms(orientation, robot), contacts, structure, height,
            spacing=robot.spacing, ramp=alpha, **gains,
        )  # fmt: skip
        moves.append(np.linalg.norm(moved - expected, axis=1).max())
        expected = moved
    np.testing.assert_allclose(result.position, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.largest_move, moves, rtol=1e-7, atol=1e-12)  # f32 on cards
    assert result.list_builds > 1


@pytest.mark.usefixtures("_way")
def test_steps_of_a_guided_swarm_are_the_equations():
    """Inertia, mobilities of which some are 0, connected docks that part, and a pause of five."""
    position, orientation, contacts = swarm(30, 3)
    mobility = np.random.default_rng(0).uniform(0.2, 1.0, (30, 3))
    mobility[0] = mobility[1:9, 1] = 0.0
    gains = {"attraction_gain": 0.3, "repulsion_gain": 0.1, "max_step": 0.3, "height_gain": 0.05}
    height = np.where(np.arange(30) % 3, 0.4, np.nan)
    ramp = np.linspace(0.0, 1.0, 12)
    guided = {"parting_gain": 0.4, "momentum": 0.8}

    prepared = engine.PreparedSwarm(
        position, orientation, contacts, robot=ROBOT, height=height, mobility=mobility
    )
    prepared.relax(**gains, **guided, ramp=ramp[:5], steps=5)
    result = prepared.relax(**gains, **guided, ramp=ramp[5:], steps=7, resume=True)

    places = [position, position]
    for alpha in ramp:
        step = swarm_step(
            places[-1], arms(orientation), contacts, np.zeros(30), height, spacing=2.0, ramp=alpha,
            parting_gain=0.4, mobility=mobility, carried=0.8 * (places[-1] - places[-2]), **gains,
        )  # fmt: skip
        places.append(step)
    np.testing.assert_allclose(result.position, places[-1], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(result.position[0], position[0])
    np.testing.assert_array_equal(result.position[:9, 1], position[:9, 1])
    again = prepared.relax(**gains, **guided, ramp=ramp[:5], steps=5)
    assert np.abs(again.position - result.position).max() > 0.01


@pytest.mark.usefixtures("_way")
def test_rows_that_are_too_short_are_made_longer():
    """Robots in one place: each has all docks of the others for neighbors."""
    position, orientation, _ = swarm(24)
    position *= 0.01

    result = relax(position, orientation, [], robot=ROBOT, ramp=0.5, steps=2, **GAINS)

    expected = position
    for _ in range(2):
        expected = swarm_step(
            expected, arms(orientation), np.empty((0, 4), int), np.zeros(24), np.full(24, np.nan),
            spacing=2.0, ramp=0.5, height_gain=0.0, **GAINS,
        )  # fmt: skip
    np.testing.assert_allclose(result.position, expected, rtol=0, atol=1e-12)


@pytest.mark.usefixtures("_way")
def test_rows_are_made_anew_once_a_robot_strayed_half_their_skin():
    """A quarter of R: not earlier, which costs time alone, wherever the robot is."""
    place, level = np.array([[30.0, -40.0, 0.0]]), [[1, 0, 0, 0]]
    rise = {"height_gain": 1.0, "max_step": 0.1}

    prepared = engine.PreparedSwarm(place, level, [], robot=ROBOT, height=[9.0])
    results = [prepared.relax(ramp=0.5, steps=12, **GAINS | rise) for _ in range(2)]

    for result in results:
        np.testing.assert_allclose(result.largest_move, 0.1, rtol=1e-6)
        assert result.list_builds == 12 / 3


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), robots=st.integers(2, 40))
def test_other_names_and_another_place_change_nothing(seed, robots):
    """Equivariance under renumbering and translation; forces of a pair add up to nothing."""
    position, orientation, contacts = swarm(robots, seed)
    rng = np.random.default_rng(seed)
    gains = GAINS | {"max_step": None}
    new = rng.permutation(robots)
    renamed = contacts.copy()
    renamed[:, [0, 2]] = new[contacts[:, [0, 2]]]
    renamed = renamed[rng.permutation(len(renamed))][:, [2, 3, 0, 1]]
    old = np.argsort(new)
    shift = rng.normal(size=3)

    result = relax(position, orientation, contacts, robot=ROBOT, ramp=0.4, steps=1, **gains)
    other = relax(
        position[old] + shift, orientation[old], renamed, robot=ROBOT, ramp=0.4, steps=1, **gains
    )

    step = result.position - position
    np.testing.assert_allclose(other.position[new] - shift - position, step, atol=1e-11)
    np.testing.assert_allclose(step.sum(axis=0), 0.0, atol=1e-11 * max(1.0, np.abs(step).max()))


def test_structures_side_by_side_are_as_if_alone():
    """No bit depends on the rest of the batch."""
    position, orientation, contacts = swarm(50, 1)
    alone = relax(position, orientation, contacts, robot=ROBOT, ramp=0.5, steps=30, **GAINS)
    more, turned, touching = swarm(70, 2)

    together = relax(
        np.concatenate([more, position]),
        np.concatenate([turned, orientation]),
        np.vstack([touching, contacts + np.array([70, 0, 70, 0])]),
        robot=ROBOT, ramp=0.5, steps=30, structure=[7] * 70 + [2] * 50, **GAINS,
    )  # fmt: skip

    np.testing.assert_array_equal(together.position[70:], alone.position)


both_small = pytest.mark.parametrize(
    "small",
    [
        pytest.param(2_000, id="by structure"),
        pytest.param(0, id="all at once", marks=pytest.mark.trial),
    ],
)


@pytest.mark.program(precision="f32")
@both_small
def test_single_precision_is_as_good_far_from_the_origin(monkeypatch, small):
    """Forces 2,000 R away are within the stated error, which is that of a swarm at the origin."""
    monkeypatch.setattr(engine, "SMALL", small)
    position, orientation, contacts = swarm(500, 4)
    options = {"robot": ROBOT, "ramp": 0.5, "steps": 1, **GAINS, "max_step": None}
    right = relax(position, orientation, contacts, **options)
    force = right.position - position

    for far in (0.0, 2_000.0):
        result = relax(position + far, orientation, contacts, precision="f32", **options)

        error = np.abs(result.position - (position + far) - force).max() / np.abs(force).max()
        assert error < result.force_error < 100 * np.finfo(np.float32).eps


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), shift=st.tuples(*[st.integers(-(10**6), 10**6)] * 3))
def test_a_shift_by_whole_units_changes_no_bit(seed, shift):
    """In f32, where centers are whole numbers of a unit, of which 2^-10 R is a multiple."""
    position, orientation, contacts = swarm(20, seed)
    position, far = np.rint(position * 2**10) / 2**10, np.array(shift) / 2**10
    options = {"robot": ROBOT, "ramp": 0.5, "steps": 5, "precision": "f32", **GAINS}

    here = relax(position, orientation, contacts, **options)
    there = relax(position + far, orientation, contacts, **options)

    np.testing.assert_array_equal(there.position - far, here.position)
    assert there.force_error == here.force_error


@both_small
def test_a_swarm_that_outgrows_its_unit_starts_again_with_a_coarser_one(small, monkeypatch):
    """Two robots blown apart by thousands of R, as in f64; the stated error grows."""
    monkeypatch.setattr(engine, "SMALL", small)
    position, level = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]), [[1, 0, 0, 0]] * 2
    gains = GAINS | {"repulsion_gain": 1e3, "max_step": None}
    found = [
        relax(position, level, [], robot=ROBOT, ramp=0.0, steps=2, precision=precision, **gains)
        for precision in ("f64", "f32")
    ]

    assert np.ptp(found[0].position) > 1_000.0
    np.testing.assert_allclose(found[1].position, found[0].position, rtol=1e-5)
    assert found[1].force_error > 1e-4


@both_small
def test_robots_that_come_back_from_beyond_the_numbers_are_right(small, monkeypatch):
    """Repulsion throws two connected robots 1,250 R away; nine steps later they are together."""
    monkeypatch.setattr(engine, "SMALL", small)
    pair = [[0, 0, 0], [0.3, 0, 0]], [[1, 0, 0, 0]] * 2, [[0, 0, 1, 0]]
    gains = {"attraction_gain": 0.5, "repulsion_gain": 100.0, "ramp": 0.5}
    right, found = (
        relax(*pair, robot=ROBOT, steps=10, precision=precision, **gains)
        for precision in ("f64", "f32")
    )

    np.testing.assert_allclose(found.position, right.position, atol=1e-4)
    assert found.largest_move[0] == pytest.approx(1_252.815, rel=1e-5)


@pytest.mark.program(precision="f32")
@both_small
@settings(max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    robots=st.integers(2, 8),
    attraction=st.floats(-2, 0.3).map(lambda power: 10**power),
    repulsion=st.floats(-2, 4).map(lambda power: 10**power),
    ramp=st.floats(0.0, 1.0),
)
@example(seed=0, robots=6, attraction=1.0, repulsion=1000.0, ramp=0.99999)
def test_a_step_in_single_precision_is_within_its_stated_error(
    small, seed, robots, attraction, repulsion, ramp
):
    """Also under gains so strong that robots fly, and the swarm starts again in a coarser unit."""
    position, orientation, contacts = swarm(robots, seed)
    gains = {"attraction_gain": attraction, "repulsion_gain": repulsion}
    pair = attraction * ramp + repulsion * (1.0 - ramp)  # two docks R from touching
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "SMALL", small)
        prepared = engine.PreparedSwarm(
            position, orientation, contacts, robot=ROBOT, precision="f32"
        )

    for step in range(4):
        try:
            found = prepared.relax(**gains, ramp=ramp, steps=1, resume=step > 0)
        except InputError:
            assert np.abs(position).max() * max(1.0, pair) > 1e4
            break
        expected = swarm_step(
            position, arms(orientation), contacts, np.zeros(robots), np.full(robots, np.nan),
            spacing=2.0, ramp=ramp, height_gain=0.0, max_step=None, **gains,
        )  # fmt: skip
        force = np.linalg.norm(expected - position, axis=1).max()
        unit = found.force_error / 64  # to which steps are rounded
        error = np.abs(found.position - expected).max()
        assert error <= found.force_error * max(force, pair) + unit
        position = found.position


@both_small
@pytest.mark.parametrize(
    "precision",
    [pytest.param("f32", marks=pytest.mark.program(precision="f32")), "f64"],
)
def test_a_swarm_outlasts_steps_that_were_too_strong(small, precision, monkeypatch):
    """Steps that outgrow the numbers, or diverge, leave no trace in later ones."""
    monkeypatch.setattr(engine, "SMALL", small)
    place, options = swarm(20), {"robot": ROBOT, "precision": precision}
    prepared = engine.PreparedSwarm(*place, **options)
    strong = {"attraction_gain": 3.0, "repulsion_gain": 1e4, "ramp": 0.5}

    prepared.relax(steps=1, **strong)
    with pytest.raises(InputError, match="diverged"):
        prepared.relax(steps=200, **strong)
    found = prepared.relax(ramp=0.5, steps=5, **GAINS)

    fresh = relax(*place, **options, ramp=0.5, steps=5, **GAINS)
    np.testing.assert_array_equal(found.position, fresh.position)
    assert found.force_error == fresh.force_error
    here = prepared.relax(ramp=0.5, steps=0, resume=True, **GAINS)
    np.testing.assert_array_equal(here.position, found.position)


@pytest.mark.program(precision="f32")
def test_a_swarm_that_leaves_what_single_precision_resolves_says_so():
    """It names the way out, and in f64 the same steps are taken."""
    pair = [[0, 0, 0], [0.3, 0, 0]], [[1, 0, 0, 0]] * 2, [[0, 0, 1, 0]]
    gains = {"attraction_gain": 0.5, "repulsion_gain": 1e7, "ramp": 0.5}

    with pytest.raises(InputError, match=r"diverged; .* or use precision f64"):
        relax(*pair, robot=ROBOT, steps=40, precision="f32", **gains)

    result = relax(*pair, robot=ROBOT, steps=40, **gains)
    assert result.largest_move[0] > 1e7
    assert result.force_error > 32 * np.finfo(np.float64).eps * 1e7


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": [[np.nan, 0, 0], [0, 0, 0]]}, "positions must be finite"),
        ({"position": [[0, 0, 0], [9, 0]]}, "position is no table of numbers"),
        ({"position": [0, 0, 0]}, r"position has shape \(3,\); expected \(N, 3\)"),
        ({"orientation_wxyz": [[1, 0, 0, 0]]}, r"orientation_wxyz has shape \(1, 4\)"),
        ({"contacts": [[0, 3, 1, 0]]}, "is not between docks 0 to 2"),
        ({"contacts": [[0, 0, 0, 1]]}, "is not between docks 0 to 2"),
        ({"contacts": [[0, 0], [1, 0]]}, r"contacts has shape \(2, 2\); expected \(C, 4\)"),
        ({"contacts": [0, 0, 1, 0]}, r"contacts has shape \(4,\); expected \(C, 4\)"),
        ({"contacts": [[0, 0, 1, 0], [1, 0]]}, r"contacts is no table of numbers"),
        ({"contacts": [[0, 0.5, 1, 0]]}, r"contacts holds 0\.5"),
        ({"contacts": [[0, np.nan, 1, 0]]}, r"contacts holds nan"),
        ({"structure": [0, 1], "contacts": [[0, 0, 1, 0]]}, "in one structure"),
        ({"ramp": [0.5]}, "one for each of 3 steps"),
        ({"repulsion_gain": -1.0}, "gains must be 0 to"),
        ({"position": [[1e9, 0, 0], [0, 0, 0]], "precision": "f32"}, "use precision f64"),
        (
            {"attraction_gain": 1e12, "steps": 9, "contacts": [[0, 0, 1, 0]], "max_step": None},
            "diverged",
        ),
        (
            {
                "attraction_gain": 1e12,
                "steps": 9,
                "contacts": [[0, 0, 1, 0]],
                "max_step": None,
                "precision": "f32",
            },
            "diverged",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(change, message):
    """In one line that says what to do."""
    arguments = {
        "position": [[0, 0, 0], [9, 0, 0]],
        "orientation_wxyz": [[1, 0, 0, 0]] * 2,
        "contacts": [],
        "robot": ROBOT,
        "ramp": 1.0,
        "steps": 3,
        **GAINS,
    }
    with pytest.raises(InputError, match=message) as caught:
        relax(**(arguments | change))
    assert "\n" not in str(caught.value)


def test_the_signature_is_short_and_has_all_types():
    """Notebooks show it above the help; spelled out, its unions fill a screen."""
    signature = inspect.signature(relax)
    hints = get_type_hints(relax)

    assert len(str(signature)) < 600
    assert set(hints) == {*signature.parameters, "return"}
    assert hints["ramp"].__value__ == ArrayLike | None
    assert hints["robot"] is Robot


def test_too_large_a_swarm_is_refused_before_memory_is_taken(monkeypatch):
    """By the memory that is free, and by what an entry can number."""
    place = swarm(100)
    monkeypatch.setattr(backend.psutil, "virtual_memory", lambda: type("", (), {"available": 1e4}))
    with pytest.raises(EnvironmentTroubleError, match="need about"):
        relax(*place, robot=ROBOT, ramp=0.5, steps=1, **GAINS)
    monkeypatch.undo()
    monkeypatch.setattr(neighbor_list, "MOST_ITEMS", 2_000)
    with pytest.raises(InputError, match="more than 2000; split the swarm"):
        relax(*place, robot=ROBOT, ramp=0.5, steps=1, **GAINS)


def test_nothing_to_do_is_done():
    """No robots, or no steps."""
    none = relax([], [], [], robot=ROBOT, ramp=0.5, steps=2, **GAINS)
    assert none.position.shape == (0, 3)
    assert none.largest_move.tolist() == [0.0, 0.0]
    place = swarm(5)
    still = relax(*place, robot=ROBOT, ramp=0.5, steps=0, **GAINS)
    np.testing.assert_array_equal(still.position, place[0])


@pytest.mark.parametrize(
    "precision",
    [pytest.param("f32", marks=pytest.mark.program(precision="f32")), "f64"],
)
@settings(max_examples=10)
@given(seed=st.integers(0, 10**6), parts=st.lists(st.integers(0, 7), min_size=1, max_size=6))
def test_steps_on_the_device_do_not_depend_on_calls(precision, seed, parts):
    """They are the same to the bit as those of one call, rows of neighbors made as often."""
    place = swarm(60, seed)
    gains = {**GAINS, "max_step": 0.1, "ramp": 0.5}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "SMALL", 0)
        whole = engine.PreparedSwarm(*place, robot=ROBOT, precision=precision)
        shared = engine.PreparedSwarm(*place, robot=ROBOT, precision=precision)
    begun = shared.relax(steps=1, **gains)

    result = whole.relax(steps=1 + sum(parts), **gains)
    for steps in parts:
        shared.step(steps, **gains)

    assert shared.taken == result.taken == begun.taken + sum(parts)
    np.testing.assert_array_equal(shared.position, result.position)
    assert shared.stepper.neighbors.builds == result.list_builds


@both_small
def test_a_swarm_on_the_device_outlasts_steps_that_were_too_strong(small, monkeypatch):
    """It is where it was before them, and goes on from there."""
    monkeypatch.setattr(engine, "SMALL", small)
    place = swarm(20)
    gains = {**GAINS, "ramp": 0.5}
    prepared = engine.PreparedSwarm(*place, robot=ROBOT)
    prepared.step(3, **gains)
    before = prepared.position

    with pytest.raises(InputError, match="diverged"):
        prepared.step(200, attraction_gain=3.0, repulsion_gain=1e4, ramp=0.5)

    np.testing.assert_array_equal(prepared.position, before)
    assert prepared.taken == 3
    prepared.step(2, **gains)
    assert prepared.taken == 5


@pytest.mark.program(precision="f32")
def test_a_swarm_on_the_device_that_outgrows_whole_numbers_takes_a_coarser_unit(monkeypatch):
    """As one that is read after each call; both end within a unit of each other."""
    monkeypatch.setattr(engine, "SMALL", 0)
    pair = [[0, 0, 0], [0.3, 0, 0]], [[1, 0, 0, 0]] * 2, [[0, 0, 1, 0]]
    strong = {"attraction_gain": 0.0, "repulsion_gain": 3e3, "ramp": 0.0}
    read, stays = (engine.PreparedSwarm(*pair, robot=ROBOT, precision="f32") for _ in range(2))

    for k in range(3):
        read.relax(steps=1, resume=k > 0, **strong)
        stays.step(1, **strong)

    assert stays.state.places.unit > read.first.places.unit
    assert stays.position == pytest.approx(read.position, abs=8 * stays.state.places.unit)
