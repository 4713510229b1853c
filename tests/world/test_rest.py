"""Docks that rest on the ground: structures stand, tip or slide as rigid bodies would."""

import dataclasses
import json
import math

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy.spatial.transform import Rotation

import tiswarm
from tests import frames, oracle_rest
from tests.frames import BODY, Standing
from tests.structures import grown
from tiswarm.base.errors import ResultWarning
from tiswarm.base.robot import RobotGeometry
from tiswarm.world import rest
from tiswarm.world.growth import grow
from tiswarm.world.history_file import from_arrays, to_arrays
from tiswarm.world.mechanics import MechanicsParams, PayloadParams, StructureFailure, parts
from tiswarm.world.params import CantileverParams, TowerParams
from tiswarm.world.strength import StrengthParams

MODELS = ("flexible", "rigid")

ROUGH = MechanicsParams(ground="rests", friction=0.5)
"""Ground on which docks rest."""


@pytest.fixture(scope="module")
def histories():
    """Structures that grew on ground that holds them, each of one part."""
    shape = RobotGeometry()
    structures = [
        *grow(TowerParams(), robots=25, seeds=[0, 1, 2], robot=shape),
        *grow(CantileverParams(anchor=3.5, founders=2), robots=25, seeds=[0, 1], robot=shape),
    ]
    return [h for h in structures if len({*parts(h.contacts[:, ::2], h.robot_count).tolist()}) == 1]


def _row(robots, *, spacing=4.0, feet=1):
    """Robots in a row along x, each lying flat, joined dock to dock; the first `feet` stand.

    Docks of neighbors are `spacing` minus their arms apart, so that contacts are beams.
    """
    center = np.zeros((robots, 3))
    center[:, 0] = spacing * np.arange(robots)
    center[:, 2] = 1.0
    turn = np.tile(np.eye(3), (robots, 1, 1))
    contacts = [(3 * j, 3 * j + 4) for j in range(robots - 1)]
    standing = np.arange(3 * feet)
    dock = (center[:, None] + BODY @ turn.swapaxes(1, 2)).reshape(-1, 3)
    return Standing(
        center=center,
        turn=turn,
        contacts=np.array(contacts, np.int32).reshape(-1, 2),
        standing=standing,
        foot=dock[standing] * [1.0, 1.0, 0.0],
    )


def _stability(structure, params):
    """Verdict of the mechanics."""
    return frames.solved(structure, params).stability[0]


@pytest.mark.parametrize("model", MODELS)
def test_verdicts_are_those_of_rigid_bodies(histories, model):
    """A linear program finds forces in the friction cones, or that there are none."""
    rng = np.random.default_rng(11)
    verdicts = []
    for history in histories:
        for _ in range(8):
            structure = frames.grown(history, int(rng.integers(2, history.robot_count + 1)))
            if parts(structure.contacts // 3, len(structure.center)).any():
                continue
            push = rng.normal(size=2) * rng.choice([0.0, 0.1, 0.3])
            params = MechanicsParams(
                model=model,
                ground="rests",
                friction=float(rng.uniform(0.1, 0.8)),
                gravity=(float(push[0]), float(push[1]), -1.0),
                payload=PayloadParams(weight=float(rng.uniform(0.1, 3.0))),
            )

            solved = frames.solved(structure, params)

            expected = oracle_rest.verdict(structure, params, int(solved.carrier[0]))
            if expected.margin > 5e-3:  # pyramids of the program are inside cones
                assert solved.stability[0] == expected.stability
                verdicts.append(expected.stability)
    assert {*verdicts} == {"stands", "tipped", "slid"}


@pytest.mark.parametrize("model", MODELS)
def test_forces_of_feet_are_in_the_cones_and_bear_the_weight(histories, model):
    """Also where some feet open and slide; no other forces in the cones cost less energy."""
    moved = 0
    for history in histories:
        for count in range(3, history.robot_count + 1, 4):
            structure = frames.grown(history, count)
            params = MechanicsParams(model=model, ground="rests", friction=0.2)
            solved = frames.solved(structure, params)
            if solved.stability[0] != "stands":
                continue

            force = solved.loads(0).ground_force

            normal = structure.dock[structure.standing] - structure.foot
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            press = (force * normal).sum(axis=1)
            rub = np.linalg.norm(force - press[:, None] * normal, axis=1)
            slack = 1e-6 * 3.0 * len(structure.center)
            assert press.min() > -slack
            assert (rub < 0.2 * press + slack).all()
            turning = np.cross(structure.foot, force).sum(axis=0)
            turning += np.cross(structure.dock, [0.0, 0.0, -1.0]).sum(axis=0)
            assert np.abs(turning).max() < 100.0 * slack
            slip = solved.frame.slip[0, structure.standing]
            opened = (slip * normal).sum(axis=1)
            slid = np.linalg.norm(slip - opened[:, None] * normal, axis=1)
            # Slips are in the dual cones, and do no work but against friction that is overcome.
            assert (opened >= 0.2 * slid - 1e-12).all()
            most = np.abs(slip).max()
            assert np.abs((slip * force).sum(axis=1)).max() <= 10.0 * slack * most
            moved += int((np.abs(slip).max(axis=1) > 0.0).sum())
    assert moved > 10


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("share", "stability"), [(0.98, "tipped"), (1.02, "stands")])
def test_a_row_of_robots_tips_once_its_center_passes_the_feet(model, share, stability):
    """By hand: a payload on the first robot keeps the center of two behind the first one's feet."""
    # Robots weigh 1 at x = 0 and at x = 4, and the feet end at the dock ahead.
    counterweight = 4.0 / BODY[0, 0] - 2.0
    payload = PayloadParams(weight=share * counterweight, at=(0.0, 0.0, 1.0))
    params = MechanicsParams(model=model, ground="rests", friction=0.5, payload=payload)

    actual = _stability(_row(2), params)

    assert actual == stability


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("friction", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("heading", [0.0, 0.7, 2.5])
def test_a_robot_slides_where_the_slope_is_steeper_than_friction(model, friction, heading):
    """By hand: it slides exactly where tan a > friction, in any direction."""
    verdicts = []
    for slope in (friction - 0.01, friction + 0.01):
        gravity = (max(slope, 0.0) * math.cos(heading), max(slope, 0.0) * math.sin(heading), -1.0)
        params = MechanicsParams(model=model, ground="rests", friction=friction, gravity=gravity)
        verdicts.append(_stability(_row(1), params))

    assert verdicts == ["stands", "slid"]


@pytest.mark.parametrize("model", MODELS)
def test_feet_on_one_line_hold_nothing(model):
    """One that stands on two docks tips about these, and says so instead of having no numbers."""
    flat = _row(1)
    two = dataclasses.replace(flat, standing=flat.standing[:2], foot=flat.foot[:2])

    with pytest.raises(StructureFailure, match="the structure tipped once robot 0 had joined"):
        frames.solve(two, MechanicsParams(model=model, ground="rests", friction=0.5))


@pytest.mark.parametrize("model", MODELS)
def test_feet_on_a_round_edge_press_along_its_normal(model):
    """Feet whose normals lean apart stand without friction as a robot in a groove does."""
    flat = _row(1)
    out = BODY / np.linalg.norm(BODY, axis=1, keepdims=True)
    leaning = 0.3 * out - [0.0, 0.0, math.sqrt(1.0 - 0.09)]
    groove = dataclasses.replace(flat, foot=flat.dock + leaning)

    forces = frames.solve(groove, MechanicsParams(model=model, ground="rests", friction=0.0))

    across = np.linalg.norm(np.cross(forces.ground_force, leaning), axis=1)
    np.testing.assert_allclose(across, 0.0, atol=1e-6)
    np.testing.assert_allclose(forces.ground_force.sum(axis=0), [0.0, 0.0, 3.0], atol=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_gravity_turns_with_a_structure(histories, model):
    """A structure and gravity that are turned together bear the same."""
    turn = Rotation.from_rotvec([0.4, -0.9, 0.3])
    for history in histories:
        upright = frames.grown(history)
        turned = dataclasses.replace(
            upright,
            center=turn.apply(upright.center),
            turn=turn.as_matrix() @ upright.turn,
            foot=turn.apply(upright.foot),
        )
        gravity = tuple(turn.apply([0.0, 0.0, -7.0]).tolist())

        actual = frames.solve(turned, model=model, gravity=gravity)

        expected = frames.solve(upright, model=model)
        np.testing.assert_allclose(actual.sensed, expected.sensed, rtol=1e-7)
        np.testing.assert_allclose(
            actual.ground_force, turn.apply(expected.ground_force), atol=1e-6
        )


@pytest.mark.parametrize("model", MODELS)
def test_a_payload_weighs_at_the_center_of_the_robot_that_carries_it(model):
    """By hand: on a row that is clamped at one end, the moment there grows by weight times arm."""
    row = _row(3)
    clamped = dataclasses.replace(row, standing=row.standing[:1], foot=row.foot[:1])
    bending = []
    for payload in (None, PayloadParams(weight=2.0, at=(9.0, 0.0, 0.0))):
        solved = frames.solved(clamped, MechanicsParams(model=model, payload=payload))
        ends, loads = solved.contact_loads(0)
        bending.append(loads.bending[ends[:, 1] < 0][0])

    # 2 robots of 3 docks at x = 8; the foot is below the first dock.
    assert bending[1] - bending[0] == pytest.approx(6.0 * (8.0 - BODY[0, 0]), rel=1e-9)


def test_a_payload_at_the_top_moves_as_the_structure_grows():
    """The highest robot carries it, of those that stand."""
    rising = _row(3)
    rising = dataclasses.replace(rising, center=rising.center * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0])
    rising.center[1, 2] = 1.2
    params = MechanicsParams(payload=PayloadParams(weight=1.0))
    carriers = []
    growing = frames.Frames(params, docks=3, robots=3)
    for j in range(3):
        frames.join(growing, 0, rising, j)
        growing.solve([0])
        carriers.append(int(growing.carrier[0]))
    growing.remove(0, np.array([1]))
    growing.solve([0])

    carriers.append(int(growing.carrier[0]))

    assert carriers == [0, 1, 1, 0]
    assert growing.frame.weight[0, :, 2].sum() == -(3 * 2 + 3)


@pytest.mark.parametrize("model", MODELS)
def test_a_payload_that_moved_leaves_no_trace(histories, model):
    """A frame solved after every join bears what one built anew does."""
    structure = frames.grown(histories[0])
    params = MechanicsParams(model=model, payload=PayloadParams(weight=1.7))
    growing = frames.Frames(params, docks=3, robots=len(structure.center))
    for j in range(len(structure.center)):
        frames.join(growing, 0, structure, j)
        growing.solve([0])

    actual = growing.loads(0)

    expected = frames.solve(structure, params).sensed
    np.testing.assert_allclose(actual.sensed, expected, rtol=0.0, atol=1e-9 * expected.max())


def test_a_payload_in_kilograms_is_one_in_weights():
    """Of robots of 2 kg, 3 kg weigh one and a half."""
    payload = PayloadParams(weight=3.0, robot_mass_kg=2.0)

    assert payload.weight_for(3) == pytest.approx(4.5, rel=1e-15)


def test_growth_ends_where_a_structure_tips_or_slides():
    """It says so, keeps what stood, and is read back."""
    params = TowerParams(anchor=0.0, mechanics=ROUGH)
    histories = grow(params, robots=12, seeds=range(6), robot=RobotGeometry())

    fallen = [history for history in histories if history.stability == "tipped"]

    assert 0 < len(fallen) < len(histories)
    for history in histories:
        back = from_arrays(to_arrays(history), params, RobotGeometry())
        assert back.stability == history.stability
    for history in fallen:
        last = history.robot_count - 1
        assert history.ended == f"the structure tipped once robot {last} had joined"
        assert not len(history.contact_load)
        assert np.isnan(history.sensed).all()
        assert len(history.sensed) == history.robot_count


def test_a_slope_that_is_too_steep_ends_growth_at_once():
    """The first robot slides."""
    steep = dataclasses.replace(ROUGH, gravity=(0.6, 0.0, -1.0))

    history = grown(TowerParams(anchor=0.0, mechanics=steep), robots=5, seed=0)

    assert history.ended == "the structure slid once robot 0 had joined"


def test_feet_that_rest_do_not_break():
    """The weakest docks still stand on the ground; contacts of docks break as before."""
    weak = StrengthParams(limit=1e-3)
    params = TowerParams(anchors=3, mechanics=ROUGH, strength=weak)

    history = grown(params, robots=3, seed=0)

    assert history.stability == "stands"
    assert not len(history.broken)
    assert (history.contact_load[:, 5] == 0.0).all()


def test_tables_say_who_tipped_or_slid():
    """Columns are there on ground on which docks rest alone."""
    tower = {"kind": "tower", "anchor": 0.0}
    settings = {"ground": "rests", "friction": 0.5}

    with pytest.warns(ResultWarning, match="tipped once robot"):
        resting = tiswarm.grow({**tower, "mechanics": settings}, robots=8, seeds=6, quiet=True)

    held = tiswarm.grow(tower, robots=3, seeds=1, quiet=True)
    tipped = [verdict == "tipped" for verdict in resting.stability]
    assert resting.table["tipped"].astype(bool).tolist() == tipped
    assert any(tipped)
    assert not resting.table["slid"].any()
    assert "tipped" not in held.table
    assert held.stability == [""]


def test_a_batch_tips_and_slides_as_each_structure_alone():
    """Verdicts and loads do not depend on company."""
    params = TowerParams(anchors=3, mechanics=ROUGH)
    seeds = [3, 4, 5]

    together = grow(params, robots=15, seeds=seeds, robot=RobotGeometry())

    for history in together:
        alone = grown(params, robots=15, seed=history.seed)
        assert history.ended == alone.ended
        np.testing.assert_array_equal(history.sensed, alone.sensed)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"gravity": [0.0, 0.0, 0.0]}, "gravity has no direction"),
        ({"gravity": [0.0, 1.0]}, r"should be a vector"),
        ({"gravity": "down"}, r"should be a vector"),
        ({"ground": "rests"}, "add friction"),
        ({"friction": 0.5}, "goes with ground: rests"),
        ({"ground": "rests", "friction": -0.1}, "greater than or equal to 0"),
        ({"payload": {"weight": 0.0}}, "greater than 0"),
        ({"payload": {"weight": 1.0, "at": "bottom"}}, "should be top, or a place"),
        ({"payload": {"weight": 1.0, "at": [0.0, 1.0]}}, "should be top, or a place"),
    ],
)
def test_settings_without_a_meaning_are_refused(settings, message):
    """One line says which and what to do."""
    with pytest.raises(ValidationError, match=message):
        TypeAdapter(MechanicsParams).validate_json(json.dumps(settings))


def test_structures_in_a_plane_do_not_rest():
    """They stand on a line."""
    with pytest.raises(ValidationError, match="leave out ground: rests"):
        TowerParams(plane=True, mechanics=ROUGH)


def test_two_masses_of_a_robot_are_refused():
    """A payload and a limit in SI units are of the same robots."""
    with pytest.raises(ValidationError, match="different mass"):
        TowerParams(
            strength=StrengthParams(law="tension", limit=9.0, robot_mass_kg=1.0),
            mechanics=MechanicsParams(payload=PayloadParams(weight=1.0, robot_mass_kg=2.0)),
        )


def test_forces_of_feet_are_those_of_least_energy():
    """Random stiffnesses: slips and forces are complementary, or a rigid motion frees energy."""
    rng = np.random.default_rng(5)
    verdicts = []
    for _ in range(60):
        count = int(rng.integers(1, 7))
        root = rng.normal(size=(3 * count, int(rng.integers(1, 3 * count + 1))))
        stiffness = 1e9 * root @ root.T
        load = root @ rng.normal(size=root.shape[1])
        normal = rng.normal(size=(count, 3)) * 0.2 + [0.0, 0.0, 1.0]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        held = load.reshape(count, 3) + rng.uniform(0.0, 3.0) * normal + rng.normal(size=3)

        resting = rest.find_slips(stiffness, held, normal, 0.4, 1.0)

        verdicts.append(resting.stability)
        if resting.stability == "stands":
            force = held + (stiffness @ resting.slip.ravel()).reshape(count, 3)
            excess, _ = rest.sliding(force, normal, 0.4)
            assert (force * normal).sum(axis=1).min() > -1e-6
            assert excess.max() < 1e-6
            work = np.abs((force * resting.slip).sum(axis=1)).max()
            assert work <= 1e-5 * np.abs(resting.slip).max(initial=1e-300)
    assert {"stands", "tipped", "slid"} <= {*verdicts}
