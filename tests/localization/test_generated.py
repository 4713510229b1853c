"""Joint on structures of rules that nothing was fitted to: bounded, finite, and never silent."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.structures import Rule, structure, with_heights
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.methods import localize_many
from tiswarm.localization.settings import JointParams, VirtualForceParams

QUICK = JointParams(chains=3, steps=800, hold_steps=100)
TANGENT = 1.1547
RULES = {
    "trees": Rule(kind="tree"),
    "trees of tangent docks": Rule(kind="tree", offset=TANGENT),
    "loops": Rule(kind="loops"),
    "loops of tangent docks": Rule(kind="loops", offset=TANGENT),
    "loops of wide docks": Rule(kind="loops", offset=3.0),
    "balls": Rule(kind="ball"),
    "balls of tangent docks": Rule(kind="ball", offset=TANGENT),
    "chains": Rule(kind="chain"),
    "chains of tangent docks": Rule(kind="chain", offset=TANGENT),
    "one dock": Rule(kind="tree", docks=1),
    "two docks": Rule(kind="loops", docks=2),
    "five docks": Rule(kind="loops", docks=5, offset=2.0),
    "eight docks": Rule(kind="ball", docks=8, offset=3.0),
    "a fifth untied": Rule(kind="loops", untied=0.2),
    "three fifths untied": Rule(kind="tree", untied=0.6, offset=TANGENT),
    "a tenth missed": Rule(kind="loops", missed=0.1),
    "a twentieth wrong": Rule(kind="loops", wrong=0.05),
}
FARTHER = 1.5
"""How many times as far off as Algorithm 1 the mean over seeds may be."""


def _check(log, estimate, truth):
    """Demand a finite estimate, and of one that converged that contacts reach every robot.

    A wrong contact that was not noticed limits nothing, as the truth itself is beyond it.
    """
    assert np.isfinite(estimate.position).all()
    assert np.isfinite(estimate.sd).all()
    if not estimate.convergence.converged:
        return
    known = pose_problem(log, JointParams())
    doubted = {tuple(row) for row in estimate.outlier_contacts.tolist()}
    trusted = np.array(
        [tuple(row) not in doubted for row in known.rows.sensed_contacts.tolist()], bool
    )
    trusted &= np.abs(known.rows.residual(truth)[: len(trusted)]) < 0.1
    bound = known.reach(0.1, trusted)
    first = np.unique(known.part, return_index=True)[1][known.part]
    distance = np.linalg.norm(estimate.position - estimate.position[first], axis=1)
    assert (distance <= bound + 1e-9).all()


@settings(max_examples=3)
@given(
    rule=st.builds(
        Rule,
        kind=st.sampled_from(["tree", "loops", "ball", "chain"]),
        docks=st.integers(1, 8),
        offset=st.sampled_from([2.5, 3.5]),
        untied=st.sampled_from([0.0, 0.6]),
        missed=st.sampled_from([0.0, 0.2]),
        wrong=st.sampled_from([0.0, 0.1]),
    ),
    robots=st.integers(2, 12),
    seed=st.integers(0, 9),
)
def test_no_structure_makes_chains_fly_apart(rule, robots, seed):
    """Whatever robots are like, and whatever their log lacks or has wrong."""
    log, truth = structure(rule, robots, seed)

    bare, level = localize_many([log, with_heights(log, truth)], [QUICK, QUICK])

    _check(log, bare, truth)
    _check(log, level, truth)


@pytest.mark.slow
@pytest.mark.parametrize("height", [False, True], ids=["contacts", "heights"])
@pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
def test_joint_is_no_worse_than_algorithm_1_anywhere(rule, height):
    """A hundred robots, ten structures of each rule, everything at its default."""
    pairs = [structure(rule, 100, seed) for seed in range(10)]
    logs = [with_heights(log, truth) if height else log for log, truth in pairs]

    joint = localize_many(logs, [JointParams()] * 10)
    sequential = localize_many(logs, [VirtualForceParams()] * 10)

    error = {}
    for name, estimates in (("joint", joint), ("virtual-force", sequential)):
        off = [e.position - truth for e, (_, truth) in zip(estimates, pairs, strict=True)]
        error[name] = np.mean([np.sqrt((o**2).sum(axis=1).mean()) for o in off])
    for (_, truth), log, estimate in zip(pairs, logs, joint, strict=True):
        _check(log, estimate, truth)
    assert error["joint"] < FARTHER * error["virtual-force"], error


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tree", "loops", "ball"])
def test_two_thousand_robots_stay_together(kind):
    """Of tangent docks, and a tenth of them not tied to the anchor."""
    log, truth = structure(Rule(kind=kind, offset=TANGENT, untied=0.1), 2000, 0)

    joint, sequential = (
        localize_many([log], [params])[0] for params in (JointParams(), VirtualForceParams())
    )

    _check(log, joint, truth)
    off, other = (
        np.sqrt(((e.position - truth) ** 2).sum(axis=1).mean()) for e in (joint, sequential)
    )
    assert off < FARTHER * other
