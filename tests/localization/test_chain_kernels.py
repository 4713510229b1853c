"""A robot anneals those near it by Langevin dynamics: steps are the equations, written out."""

import numpy as np
import pytest

from tiswarm.localization.chains.kernels import MEMORY
from tiswarm.parts.between.chain_kernels import ChainDocks, ChainRows, anneal_near

DOCKS = 1.2 * np.array([[1.0, 0.0, 0.0], [-0.5, 0.8, 0.0], [-0.5, -0.8, 0.0]])
REACH = 2.0 * 1.2 + 2.0
PLACE = np.array([[0.0, 0.0, 0.0], [2.5, 0.4, 0.2], [1.2, 2.0, 0.6]])
ROWS = ChainRows(
    np.array([0, 1, 2, 3], np.int32),
    np.array([1, 0, -1], np.int32),
    np.array([[0.3, 0.1, 0.0], [-0.3, -0.1, 0.0], [0.0, 0.0, 0.0]]),
    np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[2.0, 0.02, 0.75], [2.0, 0.02, 0.75], [1.0, 0.05, 0.0]]),
)
"""Robots 0 and 1 share a row, 2 has a height."""
CONTACTS = ChainDocks(
    np.tile(DOCKS, (3, 1, 1)),
    np.array([0, 1, 2, 2], np.int32),
    np.array([[0, 1, 1], [1, 0, 0]], np.int32),
)
"""Robots 0 and 1 touch; 2 overlaps."""


def stepped(sigma, chains=1):
    """Take one step of all robots but the first; return places and velocities by chain."""
    view = np.tile(PLACE, (chains, 1, 1))
    speed = np.zeros_like(view)
    anneal_near(
        5, REACH, np.array([sigma]), np.array([0, 1, 1], np.int32),
        *ROWS, *CONTACTS, view, speed, np.zeros_like(view),
    )  # fmt: skip
    return view, speed


def force_on(i, sigma):
    """Write the force on a robot out, row by row and dock by dock, and the mass that it needs."""
    force, held, here = np.zeros(3), 0.0, PLACE[i]
    for e in range(ROWS.start[i], ROWS.start[i + 1]):
        j, (length, variance, share) = ROWS.partner[e], ROWS.value[e]
        between = here - PLACE[j] if j >= 0 else np.zeros(3)
        apart = between + ROWS.arm[e] if j >= 0 else here
        way = ROWS.axis[e] if ROWS.axis[e].any() else apart / np.linalg.norm(apart)
        missed = way @ apart - length
        stiff = sigma**2 / (sigma**2 + variance + missed**2 / 9.0)
        push = stiff * sigma**2 * share / max(np.linalg.norm(between), 1.0)
        force += push * between - stiff * missed * way
        held += stiff
    touching = {tuple(row) for row in CONTACTS.contact[slice(*CONTACTS.start[i : i + 2])]}
    for j in {0, 1, 2} - {i}:
        for k, own in enumerate(DOCKS):
            for m, its in enumerate(DOCKS):
                apart = here + own - PLACE[j] - its
                if apart @ apart < 4.0 and (k, j, m) not in touching:
                    force += 0.5 * (1.0 - apart @ apart / 4.0) * apart
                    held += 1.0
    return force, max(1.0, held / 1.2)


@pytest.mark.parametrize("sigma", [0.05, 0.5])
def test_a_step_is_that_of_the_equations(sigma):
    """Forces from where robots were before the step, friction, and kicks of the temperature."""
    view, speed = stepped(sigma)

    assert view[0, 0].tolist() == [0.0, 0.0, 0.0]
    assert force_on(2, sigma)[1] > 1.0  # an overlap is stiff
    for i in (1, 2):
        force, mass = force_on(i, sigma)
        width = sigma * np.sqrt((1.0 - MEMORY**2) / mass)
        assert np.abs(speed[0, i] - MEMORY * force / mass).max() <= np.sqrt(3.0) * width
        moved = 0.5 * (force / mass + speed[0, i])
        np.testing.assert_allclose(view[0, i] - PLACE[i], moved, atol=1e-12)


def test_overlaps_alone_move_robots_at_no_temperature():
    """Rows have no stiffness there, and nothing kicks."""
    force, mass = force_on(1, 0.0)

    speed = stepped(0.0)[1]

    np.testing.assert_allclose(speed[0, 1], MEMORY * force / mass, atol=1e-12)


def test_each_chain_has_kicks_of_its_own():
    """Chains search from the same places, so only their kicks distinguish them."""
    view = stepped(0.5, chains=3)[0]

    assert len({each.tobytes() for each in view}) == 3
