"""Calls for help grow with what a robot senses and fade on their way from dock to dock."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiswarm.world.params import RecruitParams
from tiswarm.world.walks import recruit, relay

USUAL = RecruitParams(force_threshold=10.0, recruit_base=3.0, recruit_limit=5)


@pytest.mark.parametrize(
    ("sensed", "call"),
    [
        (0.0, 0),
        (9.999, 0),
        (10.0, 1),
        (16.30, 1),
        (16.31, 2),  # 1 + log 2 / log 3 = 1.6309
        (19.99, 2),
        (20.0, 3),
        (22.61, 3),
        (22.62, 4),  # 1 + log 4 / log 3 = 2.2619
        (24.64, 4),
        (24.65, 5),  # 1 + log 5 / log 3 = 2.4650
        (1e300, 5),
        (np.inf, 5),
    ],
)
def test_a_robot_calls_by_how_far_it_is_past_its_threshold(sensed, call):
    """Min(floor(B^(s/F - 1)), J), by hand for B = 3 and F = 10, without overflow."""
    assert recruit(np.array([sensed]), USUAL) == [call]


@pytest.mark.parametrize("limit", [0, 1, 2, 1000, 1_000_000])
def test_no_call_is_greater_than_the_limit(limit):
    """Whoever bears enough calls as loudly as it may; J = 0 silences everybody."""
    params = RecruitParams(recruit_limit=limit)

    calls = recruit(np.array([9.0, 10.0, 1e3, 1e9]), params)

    np.testing.assert_array_equal(calls, [0, min(1, limit), limit, limit])


@given(
    sensed=st.floats(0.0, 1e6),
    more=st.floats(0.0, 1e6),
    base=st.floats(1.01, 50.0),
    threshold=st.floats(0.1, 100.0),
)
def test_who_bears_more_calls_no_less(sensed, more, base, threshold):
    """The call never falls with what is sensed, and nobody calls below F."""
    params = RecruitParams(force_threshold=threshold, recruit_base=base, recruit_limit=1000)

    calm, strained = recruit(np.array([sensed, sensed + more]), params)

    assert 0 <= calm <= strained <= 1000
    assert (calm > 0) == (sensed >= threshold)


def _slow_relay(call, contacts, docks):
    """The rule dock by dock, again and again until nothing changes any more."""
    robots = len(call)
    out = {(i, k): 0 for i in range(robots) for k in range(docks)}
    while True:
        incoming = dict.fromkeys(out, 0)
        for one, other in contacts:
            p, q = divmod(int(one), docks), divmod(int(other), docks)
            incoming[p] = max(incoming[p], out[q])
            incoming[q] = max(incoming[q], out[p])
        spread = {
            (i, k): max(
                int(call[i]),
                incoming[i, k] - 1,
                max(incoming[i, other] for other in range(docks) if other != k) - 2,
            )
            for i, k in out
        }
        if spread == out:
            return [out[i, k] for i in range(robots) for k in range(docks)]
        out = spread


@st.composite
def _structures(draw):
    """What up to eight robots call, which of their docks touch, and the docks of each."""
    robots, docks = draw(st.integers(1, 8)), draw(st.integers(2, 8))
    call = draw(st.lists(st.integers(0, 9), min_size=robots, max_size=robots))
    dock = st.integers(0, docks * robots - 1)
    pair = st.tuples(dock, dock).filter(lambda ends: ends[0] // docks < ends[1] // docks)
    contacts = draw(st.lists(pair, max_size=12, unique=True)) if robots > 1 else []
    return np.array(call, np.int32), np.array(contacts, np.int64).reshape(-1, 2), docks


@given(structure=_structures())
def test_calls_spread_as_the_rule_says(structure):
    """Every zone's call, over any graph of contacts, is that of a slow loop from zero."""
    call, contacts, docks = structure

    out = relay(call, contacts, docks=docks)

    np.testing.assert_array_equal(out, _slow_relay(call, contacts, docks))


@given(structure=_structures(), seed=st.integers(0, 99))
def test_neither_the_order_nor_the_direction_of_contacts_matters(structure, seed):
    """Contacts shuffled and turned round carry the same calls."""
    call, contacts, docks = structure
    rng = np.random.default_rng(seed)
    shuffled = rng.permuted(rng.permutation(contacts), axis=1)

    out = relay(call, shuffled, docks=docks)

    np.testing.assert_array_equal(out, relay(call, contacts, docks=docks))


@given(structure=_structures(), seed=st.integers(0, 99))
def test_robots_have_no_rank(structure, seed):
    """Numbered otherwise, the same robots pass on the same."""
    call, contacts, docks = structure
    rank = np.random.default_rng(seed).permutation(len(call))
    renumbered = docks * rank[contacts // docks] + contacts % docks
    order = np.argsort(rank)

    out = relay(call[order], renumbered, docks=docks).reshape(-1, docks)

    expected = relay(call, contacts, docks=docks).reshape(-1, docks)
    np.testing.assert_array_equal(out[rank], expected)


def test_a_call_fades_by_one_in_its_zone_and_by_two_across():
    """Along a row of robots that hold each other by docks 0 and 1."""
    call = np.array([9, 0, 0, 0], np.int32)
    row = np.array([[1, 3], [4, 6], [7, 9]])

    out = relay(call, row, docks=3)

    expected = [[9, 9, 9], [8, 7, 7], [6, 5, 5], [4, 3, 3]]
    np.testing.assert_array_equal(out.reshape(-1, 3), expected)


def test_a_call_ends_with_its_cause():
    """Values are found from zero each time, so none feeds on itself around a ring."""
    ring = np.array([[1, 3], [4, 6], [0, 7]])

    np.testing.assert_array_equal(relay(np.zeros(3, np.int32), ring, docks=3), np.zeros(9))


def test_only_touching_robots_pass_calls_on():
    """Without contacts a call stays where it is."""
    out = relay(np.array([3, 0], np.int32), np.empty((0, 2), np.int64), docks=3)

    np.testing.assert_array_equal(out, [3, 3, 3, 0, 0, 0])
