"""Solutions are told apart by where robots are, and those of less residual come first."""

import numpy as np
import pytest

from tiswarm.localization.joint.uncertainty import distinct


def _chains(*shifts):
    """Chains that put the last of twelve robots, and some others half as far, off by so much."""
    rng = np.random.default_rng(0)
    weight = np.zeros(12)
    weight[-1], weight[3:6] = 1.0, 0.5
    shift = np.outer(shifts, weight)[..., None] * np.array([0.6, 0.8, 0.0])
    return rng.normal(0.0, 10.0, (12, 3)) + shift + rng.normal(0.0, 1e-3, shift.shape)


def test_chains_that_differ_by_less_than_a_dock_are_one_solution():
    """One chain alone is one too."""
    position, residual = _chains(0.0, 1.9), np.array([0.3, 0.2])

    (both,) = distinct(position, residual, 10.0 * residual, 2.0)
    (alone,) = distinct(position[:1], residual[:1], residual[:1], 2.0)

    assert (both.chains, both.residual, alone.chains) == (2, 0.2, 1)
    np.testing.assert_array_equal(both.position, position[1])


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4], [4, 2, 0, 3, 1]])
@pytest.mark.parametrize("unit", [1.0, 25.0])
def test_chains_go_with_the_best_that_they_agree_with(order, unit):
    """Whatever order they come in, and whatever unit lengths are in."""
    position, residual = _chains(0.0, 5.0, 1.5, 6.0, -1.5), np.array([0.2, 0.1, 0.3, 0.4, 0.5])

    found = distinct(
        unit * position[order], unit * residual[order], 10.0 * residual[order], 2.0 * unit
    )

    assert [solution.chains for solution in found] == [2, 3]
    for solution, best in zip(found, [1, 0], strict=True):
        assert solution.residual == unit * residual[best]
        assert solution.residual_sd == 10.0 * residual[best]
        np.testing.assert_array_equal(solution.position, unit * position[best])
