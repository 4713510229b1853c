"""The rule of growth is chosen by facts of structures, in a fixed order."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.reactivebuild import criterion

TOWER = {
    "kind": "tower", "anchor": np.nan, "spawn_behind": np.nan, "force_threshold": 10.0,
    "recruit_base": 3.0, "recruit_limit": 5, "settle": 0.0, "complete": 1.0, "rms_radius_rho": 7.0,
    "both_at_once": 0.0, "near_docks": 0.8, "pyramids": 1.0, "first_on_anchor": 1.0,
    "first_quartile": 1.0, "third_quartile": 1.0, "beyond_edge": np.nan, "of_goal": 0.6,
}  # fmt: skip
CANTILEVER = TOWER | {
    "kind": "cantilever", "anchor": 6.5, "near_docks": 1.5, "first_on_anchor": 13.0,
    "first_quartile": 10.0, "third_quartile": 16.0, "beyond_edge": 0.55, "of_goal": 0.5,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "is_kept"),
    [
        ({}, True),
        ({"complete": 0.89}, False),
        ({"rms_radius_rho": 8.2}, False),
        ({"first_on_anchor": 13.0, "first_quartile": 12.5, "third_quartile": 14.0}, True),
    ],
)
def test_towers_have_all_robots_and_the_size_that_the_errors_allow(change, is_kept):
    """1.05 times 1.64 / sqrt(.045) is 8.12; join indices do not count."""
    assert criterion.kept(pd.DataFrame([TOWER | change])).tolist() == [is_kept]


@pytest.mark.parametrize(
    ("change", "is_kept"),
    [
        ({}, True),
        ({"rms_radius_rho": 10.0}, True),
        ({"rms_radius_rho": 10.2}, False),
        ({"first_quartile": 12.5, "third_quartile": 20.0}, False),
        ({"first_quartile": 5.0, "third_quartile": 11.5}, False),
        ({"third_quartile": np.inf}, True),
        ({"beyond_edge": 0.5}, False),
    ],
)
def test_index_12_lies_between_the_quartiles_of_cantilevers(change, is_kept):
    """The bound of size is 1.05 times 3.91 / sqrt(.166), 10.08 rho."""
    assert criterion.kept(pd.DataFrame([CANTILEVER | change])).tolist() == [is_kept]


def test_towers_with_two_robots_on_the_anchor_decide_before_defaults():
    """Shares within .1 of the best are equal; then the fewest changes decide."""
    low = {"force_threshold": 3.5, "both_at_once": 0.7}
    lower = {"force_threshold": 2.5, "both_at_once": 0.75, "recruit_limit": 1}

    sets = [{}, low, lower]

    found = criterion.choose(pd.DataFrame([row | s for s in sets for row in (TOWER, CANTILEVER)]))

    assert found["kind"].tolist() == ["tower", "cantilever"]
    assert found["force_threshold"].tolist() == [3.5, 3.5]
    assert found["recruit_limit"].tolist() == [5, 5]


def test_structures_that_come_nearer_to_their_goals_go_before_defaults():
    """The smaller share of both kinds counts; shares within .1 of the best are equal."""
    nearer = {"force_threshold": 20.0, "of_goal": 0.62}
    one = {"force_threshold": 40.0, "of_goal": 0.9}
    rows = [TOWER, CANTILEVER, TOWER | nearer, CANTILEVER | nearer, TOWER | one]
    rows += [CANTILEVER | one | {"of_goal": 0.4}]

    found = criterion.choose(pd.DataFrame(rows))

    assert found["force_threshold"].tolist() == [20.0, 20.0]


def test_the_nearer_of_equal_sets_is_chosen_however_they_are_listed():
    """Shares within .1 are equal until nothing else decides; then the slack is gone."""
    sets = [({"recruit_base": 1.5}, 0.5), ({"recruit_limit": 1}, 0.55)]
    rows = [[TOWER | s, CANTILEVER | s | {"of_goal": share}] for s, share in sets]

    for listed in (rows[0] + rows[1], rows[1] + rows[0]):
        found = criterion.choose(pd.DataFrame(listed))
        assert found["recruit_limit"].tolist() == [1, 1]


def test_a_set_without_cantilevers_is_not_chosen():
    """Both kinds need a rule with the same F, B, J and share that settles."""
    rows = [TOWER, CANTILEVER, TOWER | {"force_threshold": 3.5, "both_at_once": 1.0}]

    found = criterion.choose(pd.DataFrame(rows))

    assert found["force_threshold"].tolist() == [10.0, 10.0]


def test_rarer_near_docks_in_cantilevers_decide_among_equal_towers():
    """A set that keeps the fact goes before the defaults, which do not."""
    rows = [
        TOWER, CANTILEVER, TOWER | {"recruit_base": 10.0, "near_docks": 1.0},
        CANTILEVER | {"recruit_base": 10.0, "near_docks": 0.9},
    ]  # fmt: skip

    assert criterion.choose(pd.DataFrame(rows))["recruit_base"].tolist() == [10.0, 10.0]


def test_the_anchor_is_where_the_first_robot_touches_it_as_the_twelfth():
    """Medians within 1 of the nearest are equal; then the one nearer to the edge."""
    places = [(3.5, 9.0), (5.0, 12.5), (6.5, 12.0), (8.0, 15.0)]
    rows = [CANTILEVER | {"anchor": at, "first_on_anchor": median} for at, median in places]
    rows.append(CANTILEVER | {"anchor": 5.0, "first_on_anchor": 12.0, "complete": 0.0})

    found = criterion.choose(pd.DataFrame([TOWER, TOWER | {"anchor": 0.0}, *rows]))

    assert found["anchor"].tolist()[1] == 5.0
    assert np.isnan(found["anchor"].tolist()[0])
