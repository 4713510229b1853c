"""Feet that rest: which of them open or slide, and whether a structure tips or slides.

The ground presses on a foot and holds it by friction; it neither pulls nor turns it. With normal n
and coefficient of friction mu, forces r of the ground are those of the friction cone

    r . n >= 0,    |r_t| <= mu r . n,    r_t = r - (r . n) n.

Of all forces in these cones that balance the loads, those act whose elastic energy is least: there
is one such set of forces, and there is one exactly where any forces in the cones balance the loads
(Hill's and Drucker's limit theorems; Moreau 1966). Let A be the forces on all feet from a slip of
the ground under them, and r0 those of feet that neither open nor slide. Then

    r = r0 + A p,    p the least of 1/2 p' A p + r0' p over the dual cones |p_t| mu <= p . n,

in which p is by how much feet have opened and slid. A foot that slides by |p_t| so lifts by
mu |p_t|: this changes how feet share the load, not whether they bear it.

The cones are approached by half-spaces g . r >= 0, each added where forces break it: g = n for a
foot that is pulled, g = mu n - t for one that a force along t would slide. For half-spaces G this
is a linear complementarity problem,

    x >= 0,    w = G A G' x + G r0 >= 0,    x . w = 0,    p = G' x,

which block principal pivoting solves (Judice and Pires, 1994): all feet on the wrong side change
sides at once; where that does not help, one at a time, which ends. If G A G' is singular, feet may
open so that the structure moves as a rigid body. Proximal steps x <- the solution for
G A G' + e 1 and G r0 - e x go to the solution where there is one. Otherwise their e dx goes to the
load that no force in the half-spaces bears, and the structure falls.
"""

from typing import Literal, NamedTuple

import numpy as np

from tiswarm.base.aliases import Bools, Reals

Stability = Literal["stands", "tipped", "slid"]
"""What becomes of a structure on feet that rest; empty on ground that holds them. It tips where no
forces that press on its feet balance its loads, however rough the ground; it slides where friction
is too small."""

TOLERANCE = 1e-7
"""Largest load that may be borne by nothing, per weight [1]."""

_EXACT = 1e-10
"""Largest force on the wrong side of a half-space in an exact solution, per weight [1]."""

_FARTHEST = 1e9
"""Largest slip of an exact solution, in parts of what the weight does to the stiffest foot [1]:
what resists less than that is rounding of a rigid motion."""

_SOFTNESS = (1e-6, 1e-7, 1e-8, 1e-9)
"""Stiffness e of each proximal step, in parts of that of a foot [1]; the last one goes on."""

_STEPS = 20
"""Proximal steps."""

_CUTS = 60
"""Rounds in which half-spaces are added for feet that would slide."""

_NARROWEST = 1e-4
"""Feet whose places are no farther from one line hold nothing against turning about it [R]."""


class RestingFeet(NamedTuple):
    """What G feet that rest do."""

    stability: Stability
    """Whether forces in the cones bear the loads."""

    slip: Reals
    """By how much the feet have opened and slid [R], shape (G, 3)."""


def are_spread(foot: Reals) -> bool:
    """Whether feet, shape (G, 3), are not all on one line: held feet then hold a body."""
    if len(foot) < 3:  # noqa: PLR2004 - three points make a triangle
        return False
    widths = np.linalg.svd(foot - foot.mean(axis=0), compute_uv=False)
    return bool(widths[1] > _NARROWEST)


def sliding(force: Reals, normal: Reals, friction: float) -> tuple[Reals, Reals]:
    """Split the forces on feet, shape (G, 3).

    Returns:
        By how much the part along the ground exceeds friction, shape (G,), and that part,
        shape (G, 3).
    """
    press = (force * normal).sum(axis=1)
    along = force - press[:, None] * normal
    excess: Reals = np.linalg.norm(along, axis=1) - friction * np.maximum(press, 0.0)
    return excess, along


def find_slips(
    stiffness: Reals, held: Reals, normal: Reals, friction: float, weight: float
) -> RestingFeet:
    """Find by how much feet open and slide, or that they cannot bear the loads.

    Args:
        stiffness: A, forces on feet from slips of the ground [weight of a dock / R], shape
            (3 G, 3 G).
        held: r0, forces on feet that neither open nor slide [weight of a dock], shape (G, 3).
        normal: Unit vectors out of the ground, shape (G, 3).
        friction: Coefficient mu [1].
        weight: Of the structure [weight of a dock].
    """
    count = len(held)
    # Without units: forces per weight, slips per what the weight does to the stiffest foot.
    scale = float(np.abs(np.diag(stiffness)).max())
    response = 0.5 * (stiffness + stiffness.T) / scale
    start = held.ravel() / weight
    half_spaces: Reals = np.zeros((count, count, 3))
    half_spaces[np.arange(count), np.arange(count)] = normal
    cone: Reals = half_spaces.reshape(count, -1)
    multiplier, is_borne = _complementary(response, start, cone, np.zeros(count))
    stability: Stability = "stands" if is_borne else "tipped"
    for _ in range(_CUTS):
        slip = cone.T @ multiplier
        force = (start + response @ slip).reshape(count, 3)
        excess, along = sliding(force, normal, friction)
        slides = np.flatnonzero(excess > TOLERANCE)
        if stability != "stands" or not len(slides):
            break
        # Half-spaces that no force touches only make others parallel to them.
        is_kept = (np.arange(len(cone)) < count) | (multiplier > 0.0)
        cone = cone[is_kept]
        multiplier = multiplier[is_kept]
        direction = along[slides] / np.linalg.norm(along[slides], axis=1, keepdims=True)
        added = np.zeros((len(slides), count, 3))
        added[np.arange(len(slides)), slides] = friction * normal[slides] - direction
        cone = np.concatenate([cone, added.reshape(len(slides), -1)])
        multiplier = np.concatenate([multiplier, np.zeros(len(slides))])
        multiplier, is_borne = _complementary(response, start, cone, multiplier)
        if not is_borne:
            stability = "slid"
    slip = cone.T @ multiplier
    return RestingFeet(stability, (weight / scale * slip).reshape(count, 3))


def _complementary(
    response: Reals, start: Reals, cone: Reals, multiplier: Reals
) -> tuple[Reals, bool]:
    """Solve the complementarity problem; see the module.

    Args:
        response: A, shape (n, n).
        start: r0, shape (n,).
        cone: G, shape (m, n).
        multiplier: x to start from, shape (m,).

    Returns:
        x, shape (m,), and whether the loads are borne.
    """
    matrix = cone @ response @ cone.T
    offset = cone @ start
    is_basic = multiplier > 0.0
    unborne = np.inf
    for step in range(_STEPS):
        softness = _SOFTNESS[min(step, len(_SOFTNESS) - 1)]
        soft = matrix + softness * np.eye(len(offset))
        moved, is_basic = _pivot(soft, offset - softness * multiplier, is_basic)
        unborne = float(np.abs(softness * (moved - multiplier)).max(initial=0.0))
        multiplier = moved
        exact = _solve_basic(matrix, offset, is_basic)
        force = matrix @ exact + offset
        is_exact = np.where(is_basic, np.abs(force) <= _EXACT, force >= -_EXACT)
        is_small = exact.min(initial=0.0) >= 0.0 and exact.max(initial=0.0) <= _FARTHEST
        if is_exact.all() and is_small:
            return exact, True
        if unborne <= _EXACT:
            break
    return multiplier, unborne <= TOLERANCE


def _solve_basic(matrix: Reals, offset: Reals, is_basic: Bools) -> Reals:
    """Solve for the basic variables, the others being 0; 0 where these have no solution."""
    solution = np.zeros(len(offset))
    basic = np.flatnonzero(is_basic)
    try:
        solution[basic] = np.linalg.solve(matrix[np.ix_(basic, basic)], -offset[basic])
    except np.linalg.LinAlgError:
        return np.zeros(len(offset))
    return solution


def _pivot(matrix: Reals, offset: Reals, is_basic: Bools) -> tuple[Reals, Bools]:
    """Solve x >= 0, w = matrix x + offset >= 0, x . w = 0 for a positive definite matrix.

    Args:
        matrix: Shape (m, m).
        offset: Shape (m,).
        is_basic: Which x are not 0, to start from, shape (m,).
    """
    fewest = len(offset) + 1
    patience = 0
    solution: Reals = np.zeros(len(offset))
    for _ in range(20 + 10 * len(offset)):
        solution = _solve_basic(matrix, offset, is_basic)
        force = matrix @ solution + offset
        noise = 1e-14 * (1.0 + np.abs(solution).max(initial=0.0))
        is_wrong = np.where(is_basic, solution < 0.0, force < -noise)
        wrong = np.flatnonzero(is_wrong)
        if not len(wrong):
            break
        if len(wrong) < fewest:
            fewest = len(wrong)
            patience = 3
        elif patience:
            patience -= 1
        else:
            wrong = wrong[-1:]
        is_basic = is_basic.copy()
        is_basic[wrong] = ~is_basic[wrong]
    return np.maximum(solution, 0.0), is_basic
