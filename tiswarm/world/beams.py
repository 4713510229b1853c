"""Round beams between docks: their stiffness, and the forces at their ends.

Euler-Bernoulli beams in three dimensions, small deflections. A node moves by (u, theta):
displacement [R] and rotation [rad]. For a beam of length L along the unit vector e, with
axial stiffness EA, radius r and so EI = EA r^2 / 4 and GJ = EI / (1 + nu), the forces and
moments at its first end are

    F = (EA/L e e' + 12 EI/L^3 P) (u1 - u2) + 6 EI/L^2 S (t1 + t2)
    M = 6 EI/L^2 S' (u1 - u2) + (GJ/L e e' + 4 EI/L P) t1 + (2 EI/L P - GJ/L e e') t2

with P = 1 - e e' and S t = t x e (Przemieniecki, Theory of Matrix Structural Analysis, 1968).
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cross_matrix(vector: Array) -> Array:
    """Matrices of v x, shape (n, 3, 3), for vectors v, shape (n, 3)."""
    matrix = np.zeros((len(vector), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[:, i, j] = -vector[:, k]
        matrix[:, j, i] = vector[:, k]
    return matrix


def stiffness(span: Array, axial: float, radius: float, poisson: float) -> Array:
    """Stiffness of beams, nodes in the order first end, second end.

    Args:
        span: First end to second end [R], shape (n, 3).
        axial: EA [weight of a dock].
        radius: r [R].
        poisson: Poisson's ratio [1].

    Returns:
        Shape (n, 12, 12): end forces and moments from end displacements and rotations.
    """
    length = np.linalg.norm(span, axis=1)[:, None, None]
    e = span[:, :, None] / length
    along = e @ e.swapaxes(1, 2)
    across = np.eye(3) - along
    bending = 0.25 * axial * radius**2
    torsion = bending / (1.0 + poisson)
    couple = -6.0 * bending / length**2 * cross_matrix(e[:, :, 0])
    push = axial / length * along + 12.0 * bending / length**3 * across
    near = torsion / length * along + 4.0 * bending / length * across
    far = 2.0 * bending / length * across - torsion / length * along
    turned = couple.swapaxes(1, 2)
    matrix = np.empty((len(span), 12, 12))
    rows = (
        (push, couple, -push, couple),
        (turned, near, -turned, far),
        (-push, -couple, push, -couple),
        (turned, far, -turned, near),
    )
    for i, row in enumerate(rows):
        for j, part in enumerate(row):
            matrix[:, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = part
    return matrix


def rigid_link(arm: Array) -> Array:
    """Motion of a point at `arm` from a rigid body's node, from the node's own.

    Args:
        arm: Node to point [R], shape (n, 3).

    Returns:
        Shape (n, 6, 6).
    """
    link = np.tile(np.eye(6), (len(arm), 1, 1))
    link[:, :3, 3:] = -cross_matrix(arm)
    return link
