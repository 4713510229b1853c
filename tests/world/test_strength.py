"""Contacts over their strength break, and robots that nothing ties to the ground fall."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.cluster.hierarchy import DisjointSet

import tiswarm
from tests.structures import grown
from tiswarm.base.robot import RobotGeometry
from tiswarm.localization.methods import localize
from tiswarm.scenario.expansion import load_scenario
from tiswarm.sensing import SensingParams, observe
from tiswarm.world.growth import grow
from tiswarm.world.history import FELL
from tiswarm.world.history_file import find_fault, from_arrays, to_arrays
from tiswarm.world.mechanics import ContactLoads
from tiswarm.world.params import BridgeParams, CantileverParams, DepartureParams, TowerParams
from tiswarm.world.strength import StrengthParams

WEAK = StrengthParams(limit=120.0, scatter=0.2)
"""Docks so weak that towers of some 30 robots lose contacts."""


@pytest.fixture(scope="module")
def torn():
    """Towers of weak docks, most of which lose robots."""
    params = TowerParams(strength=WEAK)
    return grow(params, robots=40, seeds=range(2000, 2006), robot=RobotGeometry())


def _parts(history, *, with_ground):
    """Sets of robots that contacts which hold join, written out; the ground is -1."""
    parts = DisjointSet([-1, *np.flatnonzero(~history.is_gone).tolist()])
    broken = {tuple(row[:4]) for row in history.broken.tolist()}
    for j, walk in enumerate(history.walks):
        for dock, i, touched in walk.at_rest(walk.contacts).tolist():
            holds = (i, touched, j, dock) not in broken
            if holds and not history.is_gone[[i, j]].any():
                parts.merge(i, j)
        feet = np.concatenate([walk.at_rest(walk.ground_docks), walk.at_rest(walk.edge_docks)])
        for (dock,) in feet.tolist():
            if with_ground and (j, dock, -1, -1) not in broken and not history.is_gone[j]:
                parts.merge(j, -1)
    return parts


def test_no_contact_bears_more_than_it_can(torn):
    """Growth goes on only once all contacts hold."""
    used = np.concatenate([history.contact_load[:, 5] for history in torn])

    assert sum(len(history.broken) for history in torn) > 5
    assert used.max() <= 1.0


def test_who_stands_is_tied_to_the_ground_and_nobody_else(torn):
    """By a graph of what is left, written out; anchors stay in any case."""
    for history in torn:
        tied = _parts(history, with_ground=True).subset(-1) - {-1}

        assert {*np.flatnonzero(~history.is_gone).tolist()} == tied | {0}
        assert find_fault(history, contact_gap=0.02) == ""


def test_robots_fall_and_say_so(torn):
    """Rows of departures are those that no longer stand."""
    for history in torn:
        robot, _, event = history.departures.T

        assert (event == FELL).all()
        assert {*robot.tolist()} == {*np.flatnonzero(history.is_gone).tolist()}


def test_docks_of_any_strength_build_what_docks_without_one_do():
    """A limit that nothing reaches changes no robot."""
    strong = TowerParams(strength=StrengthParams(limit=1e9))

    actual = grown(strong, robots=25, seed=3)

    expected = grown(TowerParams(), robots=25, seed=3)
    np.testing.assert_array_equal(actual.position, expected.position)
    np.testing.assert_array_equal(actual.peak_stress, expected.peak_stress)
    assert not len(actual.broken)
    assert np.isfinite(actual.margin).all()
    assert np.isnan(expected.margin).all()


def test_a_seed_breaks_the_same_in_any_company():
    """Strengths are drawn by contact."""
    params = TowerParams(strength=WEAK, movers=3)
    seeds = [2001, 2002, 2003]

    together = grow(params, robots=30, seeds=seeds, robot=RobotGeometry())

    for history in together:
        alone = grown(params, robots=30, seed=history.seed)
        np.testing.assert_array_equal(history.position, alone.position)
        np.testing.assert_array_equal(history.broken, alone.broken)


def test_a_bridge_is_closed_only_while_contacts_join_its_sides():
    """By components of what is left, with the sides of feet."""
    params = BridgeParams(gap=12.0, strength=StrengthParams(limit=400.0))
    histories = grow(params, robots=50, seeds=range(2000, 2006), robot=RobotGeometry())
    closed = []
    for history in histories:
        feet = np.concatenate([history.ground_docks, history.edge_docks])[:, 0]
        side = {int(robot): history.position[robot, 0] > 0.5 * params.gap for robot in feet}

        sides = [
            {side[robot] for robot in part if robot in side}
            for part in _parts(history, with_ground=False).subsets()
        ]

        closed.append(any(len(both) > 1 for both in sides))
    assert closed == [history.crossed for history in histories]
    assert any(closed)


def test_dead_robots_fall_too():
    """They bear load as others do."""
    params = TowerParams(strength=WEAK, departures=DepartureParams(rate=0.3, kind="die"))

    history = grown(params, robots=40, seed=2001)

    assert find_fault(history, contact_gap=0.02) == ""


@pytest.mark.parametrize(
    ("law", "limit", "further", "expected"),
    [
        ("tension", 767.0, {}, 767.0 / (2.0 * 9.80665 / 3.0)),
        ("shear", 10.0, {}, 10.0 / (2.0 * 9.80665 / 3.0)),
        ("bending", 3.0, {"radius_mm": 30.0}, 3.0 / (2.0 * 9.80665 / 3.0 * 0.030)),
        ("von-mises", 2.0, {"radius_mm": 30.0}, 2.0 * 30.0**2 / (2.0 * 9.80665 / 3.0)),
    ],
)
def test_limits_in_newtons_are_those_in_weights(law, limit, further, expected):
    """A dock weighs a third of a robot of three docks; an R is the radius of a dock."""
    params = StrengthParams(law=law, limit=limit, robot_mass_kg=2.0, **further)

    assert params.limit_for(3) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    "settings",
    [
        {"limit": 0.0},
        {"limit": 1.0, "law": "glue"},
        {"limit": 1.0, "radius_mm": 30.0},
        {"limit": 1.0, "robot_mass_kg": 2.0},
        {"limit": 1.0, "law": "tension", "robot_mass_kg": 2.0, "radius_mm": 30.0},
    ],
)
def test_settings_without_a_meaning_are_refused(settings):
    """No limit, no law of the name, a mass without a radius, or the reverse."""
    with pytest.raises(ValidationError):
        StrengthParams(**settings)


def test_strengths_scatter_as_stated():
    """Logarithms have the mean and standard deviation stated; a contact has one strength."""
    ends = np.column_stack([np.arange(20_000), np.arange(20_000) // 2 - 1])
    params = StrengthParams(limit=50.0, scatter=0.3)

    drawn = np.log(params.strength(7, ends, 3) / 50.0)

    assert abs(drawn.mean()) < 0.01
    assert drawn.std() == pytest.approx(0.3, rel=0.03)
    np.testing.assert_array_equal(params.strength(7, ends[:, ::-1], 3), params.strength(7, ends, 3))


def test_pressed_contacts_do_not_tear():
    """The law of tension counts a pull alone."""
    loads = ContactLoads(*np.array([[-5.0, 4.0], *3 * [[9.0, 9.0]], [9.0, 9.0]]))

    used = StrengthParams(law="tension", limit=2.0).used(0, np.array([[3, 0], [6, -1]]), loads, 3)

    np.testing.assert_array_equal(used, [0.0, 2.0])


def test_structures_that_broke_are_read_back(torn):
    """Files keep what broke, and the loads of what holds."""
    params = TowerParams(strength=WEAK)
    for history in torn:
        back = from_arrays(to_arrays(history), params, RobotGeometry())

        np.testing.assert_array_equal(back.broken, history.broken)
        np.testing.assert_array_equal(back.contact_load, history.contact_load)
        np.testing.assert_array_equal(back.is_gone, history.is_gone)


def test_robots_do_not_sense_contacts_that_broke(torn):
    """Logs of the end lack them; those with robots that fell stay, as with robots that leave."""
    for history in torn:
        log = observe(history, SensingParams())

        rows = {*map(tuple, log.contacts.tolist())}
        assert not rows & {tuple(row[:4]) for row in history.broken.tolist()}
        assert {*map(tuple, history.contacts.tolist())} <= rows


@pytest.mark.parametrize("method", ["joint", "hop-by-hop", "least-squares", "online"])
def test_methods_localize_what_is_left(torn, method):
    """Whoever stands has a place, also where all but the anchor fell."""
    for history in torn[:3]:
        params = load_scenario(
            {"name": "x", "robots": 2, "seeds": 1, "structure": {"kind": "tower"},
             "localization": {"method": method}}
        ).localization  # fmt: skip

        estimate = localize(observe(history, SensingParams()), params)

        stands = ~history.is_gone & ~estimate.disconnected
        assert np.isfinite(estimate.position[stands]).all()


def test_a_law_of_a_plugin_breaks_contacts():
    """Its function gets the loads of contacts."""

    @tiswarm.strength("peel-of-a-test")
    def peel(loads):
        return np.abs(loads.axial) + 2.0 * loads.bending

    params = TowerParams(strength=StrengthParams(law="peel-of-a-test", limit=20.0))

    history = grown(params, robots=30, seed=2000)

    axial, _, bending, *_, used = history.contact_load.T
    np.testing.assert_allclose(used, (np.abs(axial) + 2.0 * bending) / 20.0, rtol=1e-12)
    assert len(history.broken)


@pytest.mark.parametrize("least", [-1.0, -0.0])
def test_a_load_below_zero_loads_nothing(least):
    """A contact that a law finds pressed has no margin, as one that `tension` finds pressed."""

    @tiswarm.strength("pull-of-a-test")
    def pull(loads):
        return np.where(loads.axial > 0.0, loads.axial, least * np.abs(loads.axial))

    law = StrengthParams(law="pull-of-a-test", limit=1e3)

    history = grown(TowerParams(strength=law), robots=12, seed=2000)

    tension = StrengthParams(law="tension", limit=1e3)
    expected = grown(TowerParams(strength=tension), robots=12, seed=2000)
    assert (history.contact_load[:, 0] < 0.0).any()
    assert not np.signbit(history.contact_load[:, 5]).any()
    np.testing.assert_array_equal(history.contact_load, expected.contact_load)
    np.testing.assert_array_equal(history.margin, expected.margin)


@pytest.mark.parametrize(
    ("law", "problem"),
    [
        (lambda _loads: 1.0, "return numbers of shape"),
        (lambda loads: np.full_like(loads.axial, np.nan), "not finite; return finite numbers"),
        (lambda loads: np.full_like(loads.axial, -np.inf), "not finite; return finite numbers"),
    ],
)
def test_what_a_law_wrongly_returns_is_a_line(law, problem):
    """Of another shape, or not finite."""
    tiswarm.strength("wrong-of-a-test")(law)

    params = TowerParams(strength=StrengthParams(law="wrong-of-a-test", limit=1.0))

    with pytest.raises(tiswarm.base.plugins.PluginError, match=problem):
        grown(params, robots=3, seed=0)


def test_robots_that_build_by_estimates_need_docks_that_hold():
    """What they believe of robots that fell has no place yet."""
    with pytest.raises(ValidationError, match="leave out strength"):
        TowerParams(strength=WEAK, navigate_by="estimate")


def test_cantilevers_need_stronger_docks_than_towers():
    """By the same law, at a strength that every tower of 30 has to spare."""
    strength = StrengthParams(limit=300.0)
    shape = {"robots": 30, "seeds": range(2000, 2004), "robot": RobotGeometry()}

    towers = grow(TowerParams(strength=strength), **shape)
    cantilevers = grow(CantileverParams(strength=strength), **shape)

    assert not any(len(history.broken) for history in towers)
    assert any(len(history.broken) for history in cantilevers)


def test_arrays_of_a_batch_have_loads_and_what_broke():
    """A row of loads for each contact that holds; shares of strength are margins, inverted."""
    tower = {"kind": "tower", "strength": {"limit": 120.0}}

    swarms = tiswarm.grow(tower, robots=30, seeds=[2001, 2002], quiet=True)

    assert swarms.contact_load.shape == (len(swarms.loaded_contacts), 6)
    assert {*np.unique(swarms.broken[:, 0]).tolist()} <= {0, 1}
    for structure in range(2):
        rows = swarms.loaded_contacts[:, 0] == structure
        most = swarms.contact_load[rows, 5].max()
        assert np.nanmin(swarms.margin[structure]) == pytest.approx(1.0 / most, rel=1e-12)
