"""Branches are what robots far from the anchor fall apart into."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from tiswarm.localization.chains.views import find_subtrees
from tiswarm.measurements.contacts import touching

ROBOTS = 12
PAIRS = st.lists(
    st.tuples(st.integers(0, ROBOTS - 1), st.integers(0, ROBOTS - 1)).filter(
        lambda p: p[0] != p[1]
    ),
    max_size=24,
)
ROOTS = st.sets(st.integers(1, ROBOTS - 1), max_size=2).map({0}.union)


@given(pairs=PAIRS, roots=ROOTS)
def test_branches_are_the_parts_of_what_is_so_far_from_the_anchor_or_more(pairs, roots):
    """Each in one row, own robots first, and each after the one that it grows out of.

    Roots of other parts are tied to the anchor, so that each part is a branch.
    """
    pair = np.array(pairs, np.int64).reshape(-1, 2)
    level = _levels([*pairs, *((root, 0) for root in roots)])

    tree = find_subtrees(pair, np.array(sorted(roots)), ROBOTS)

    own = np.split(tree.order, tree.first[1:-1])
    members = [set(robots.tolist()) for robots in own]
    for k in range(len(own) - 1, 0, -1):
        assert tree.parent[k] < k
        members[tree.parent[k]] |= members[k]
    parts = []
    for hops in range(1, max(level) + 1):
        far = np.flatnonzero(np.array(level) >= hops)
        part = connected_components(touching(pair, ROBOTS).tocsr()[far][:, far], directed=False)[1]
        parts += [set(far[part == which].tolist()) for which in set(part.tolist())]
    assert members[0] == set(range(ROBOTS))
    assert sorted(map(sorted, members[1:])) == sorted(map(sorted, parts))
    for k, robots in enumerate(members):
        assert set(tree.order[tree.first[k] :][: len(robots)].tolist()) == robots
        assert len({level[i] for i in own[k].tolist()} - {-1}) == 1


@given(pairs=PAIRS, seed=st.integers(0, 99))
def test_branches_do_not_depend_on_how_contacts_are_told(pairs, seed):
    """Not on their order, on who of two tells, or on how often."""
    rng = np.random.default_rng(seed)
    pair = np.array(pairs, np.int64).reshape(-1, 2)
    other = rng.permutation(np.concatenate([pair, pair[:3]]))
    other = np.where(rng.random(len(other))[:, None] < 0.5, other, other[:, ::-1])

    anchor = np.zeros(1, np.int64)
    told, retold = (find_subtrees(each, anchor, ROBOTS) for each in (pair, other))

    np.testing.assert_array_equal(told.order, retold.order)
    np.testing.assert_array_equal(told.first, retold.first)
    np.testing.assert_array_equal(told.parent, retold.parent)


def _levels(pairs):
    level = [0] + [-1] * (ROBOTS - 1)
    for hops in range(1, ROBOTS):
        for i, j in [*pairs, *((j, i) for i, j in pairs)]:
            if level[i] == hops - 1 and level[j] < 0:
                level[j] = hops
    return level
