"""One loop of steps serves all costs: which of them count, and when they end."""

from dataclasses import dataclass

import numpy as np
import pytest

from tests.structures import NOISY
from tiswarm.compute import normal_equations
from tiswarm.localization.chains.problem import pose_problem
from tiswarm.localization.cost.cost import SETTLED, Cost, State, WholeCost, shortened
from tiswarm.localization.cost.linear import Linear
from tiswarm.localization.settings import JointParams
from tiswarm.sensing import observe


@dataclass
class Slope:
    """A cost of one robot near a place: its residuals and their derivatives."""

    residual: np.ndarray
    jacobian: np.ndarray

    @property
    def cost(self):
        """Sum of squares."""
        return float(self.residual @ self.residual)


class Valley(Cost):
    """A narrow bent valley (Rosenbrock, Computer Journal 1960), least at (1, 1, 0)."""

    def __init__(self):
        self.seen = []

    def linearized(self, state):
        """Note where the cost was asked for."""
        x, y, z = state.position[0]
        self.seen.append(state.position[0])
        residual = np.array([10.0 * (y - x * x), 1.0 - x, z])
        jacobian = np.array([[-20.0 * x, 10.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        return Slope(residual, jacobian)

    def moved(self, state, linear, radius):
        """Step to the damped minimum, 1 R at most."""
        slope = linear.jacobian.T @ linear.residual
        information = linear.jacobian.T @ linear.jacobian + radius**-2.0 * np.eye(3)
        step = shortened(-np.linalg.solve(information, slope)[None], 1.0)
        return State(state.position + step, state.turn), float(-slope @ step[0])


def cost_at(place):
    """Cost of a place."""
    return Valley().linearized(State(place[None], np.zeros((1, 3)))).cost


@pytest.mark.parametrize("start", [(-1.2, 1.0, 0.5), (-0.5, 2.0, 0.0), (0.0, 0.0, 0.0)])
def test_steps_that_lead_uphill_are_taken_back(start):
    """The linear problem leads out of a bent valley; no state on the way costs more than before."""
    valley, begin = Valley(), State(np.array([start]), np.zeros((1, 3)))

    state, linear = valley.refine(begin, 30)

    costs = np.array([cost_at(place) for place in valley.seen])
    assert np.diff(costs).max() > 1.0
    assert linear.cost <= costs.min() + SETTLED
    assert linear.cost == pytest.approx(cost_at(state.position[0]))
    assert linear.cost < 0.2 * costs[0]


def test_no_step_is_tried_that_promises_little():
    """Evaluating the cost there would take longer than the gain is worth."""
    valley, begin = Valley(), State(np.array([[0.9, 0.81, 0.0]]), np.zeros((1, 3)))
    valley.least_reduction = 1.0

    state, _ = valley.refine(begin)

    assert len(valley.seen) == 1
    np.testing.assert_array_equal(state.position, begin.position)


def test_a_state_is_linearized_where_no_round_is_asked_for():
    """Its variance is asked for where robots stand."""
    valley, begin = Valley(), State(np.array([[2.0, 0.0, 0.0]]), np.zeros((1, 3)))

    state, linear = valley.refine(begin, 0)

    assert state is begin
    assert linear.cost == pytest.approx(cost_at(begin.position[0]))


def test_steps_beyond_the_most_are_shortened():
    """Their direction stays; other lengths than their own may decide."""
    step = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.4]])

    short = shortened(step, 1.0)

    np.testing.assert_allclose(short, [[0.6, 0.8, 0.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.4]])
    np.testing.assert_allclose(shortened(step, 1.0, np.array([2.0, 1.0, 4.0]))[[0, 2]],
                               [[1.5, 2.0, 0.0], [0.075, 0.0, 0.1]])  # fmt: skip


def test_a_search_of_many_unknowns_factors_information_once(tall_towers, monkeypatch):
    """Further steps are iterated from these factors, and the minimum is the same."""
    history = tall_towers[0]
    log = observe(history, NOISY)
    cost = WholeCost(log, pose_problem(log, JointParams()).rows).held(np.full(30, 2.0))
    start = cost.at(history.position, np.zeros(30))
    of_own, linear_of_own = cost.refine(start)
    counted = []
    factored = Linear._factored  # noqa: SLF001 - nothing else says how often it is done

    def counting(self, *arguments):
        counted.append(self)
        return factored(self, *arguments)

    monkeypatch.setattr(Linear, "_factored", counting)
    monkeypatch.setattr(normal_equations, "_AS_LONG", 1)
    cost.nearby.factors = None

    state, linear = cost.refine(start)
    again, _ = cost.refine(start)

    assert len(counted) == 1
    assert linear.cost == pytest.approx(linear_of_own.cost, abs=1e-4)
    np.testing.assert_allclose(state.position, of_own.position, atol=1e-4)
    np.testing.assert_allclose(again.position, of_own.position, atol=1e-4)
