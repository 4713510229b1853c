"""Spheres and planes that a robot lies on, against their equations row by row."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from tiswarm.localization.trilateration import INDEPENDENT, POINTS, Ties, Trilateration

WORLD = 8
"""Number of the world, after eight robots."""


class Scene:
    """Two robots, 6 and 7, that see placed ones; exact rows, of unlike variance.

    The first has `spheres` spheres and `planes` planes, the second one of each more.
    """

    def __init__(self, spheres, planes, seed=0, off=0.0):
        """Draw positions, rows, and covariances of partners, all in R."""
        draw = np.random.default_rng(seed)
        self.position = np.append(draw.uniform(-4.0, 4.0, (WORLD, 3)), np.zeros((1, 3)), axis=0)
        factor = draw.normal(0.0, 0.1, (WORLD + 1, 3, 3))
        factor[WORLD] = 0.0
        self.covariance = factor @ factor.swapaxes(1, 2)
        rows = []
        for robot, more in ((6, 0), (7, 1)):
            for k in range(spheres + more + planes + more):
                is_sphere = k < spheres + more
                partner = WORLD if k == spheres + more else int(k % 6)
                shift, normal = draw.normal(size=(2, 3))
                normal *= (not is_sphere) / np.linalg.norm(normal)
                away = self.position[robot] - self.position[partner] - shift
                reach = np.linalg.norm(away) if is_sphere else normal @ away
                reach += off * draw.normal()
                variance = draw.uniform(0.01, 0.1)
                rows.append((robot, partner, shift, normal, reach, variance, is_sphere))
            rows.append((robot, WORLD, np.zeros(3), np.zeros(3), 0.0, np.inf, False))
        self.rows = rows
        self.ties = Ties._make(np.array(column) for column in zip(*rows, strict=True))
        self.solver = Trilateration(self.ties, self.position, self.covariance)
        self.truth = self.position[[6, 7]]

    def of(self, robot):
        """Rows of a robot, without the one of infinite variance."""
        return [row for row in self.rows if row[0] == robot and np.isfinite(row[5])]

    def precision(self, row):
        """Inverse variance of a row: of a partner's, the mean or that along the normal."""
        _, partner, _, normal, _, variance, is_sphere = row
        of_partner = self.covariance[partner]
        along = np.trace(of_partner) / 3.0 if is_sphere else normal @ of_partner @ normal
        return 1.0 / (variance + along)

    def missed(self, row, point):
        """What a point misses a row by, and the unit vector along which it does [R]."""
        _, partner, shift, normal, reach, _, is_sphere = row
        away = point - self.position[partner] - shift
        if is_sphere:
            return np.linalg.norm(away) - reach, away / np.linalg.norm(away)
        return normal @ away - reach, normal


SCENES = [(3, 0), (4, 0), (0, 3), (2, 2), (5, 3)]


@pytest.mark.parametrize("counts", SCENES)
@pytest.mark.parametrize("seed", range(3))
def test_rows_are_linear_equations_of_a_point_and_its_square(counts, seed):
    """Where the robot is, all hold; their coefficients are those of rows that are distances."""
    scene = Scene(*counts, seed)
    solver = scene.solver

    row, value = solver._linear()

    offset = scene.truth - solver.origin
    solution = np.column_stack([offset, (offset**2).sum(axis=1) / 2.0])
    left = (row * solution[solver.of]).sum(axis=1)
    np.testing.assert_allclose(left, value, atol=1e-12)
    for k, robot in enumerate((6, 7)):
        spheres = [r for r in scene.of(robot) if r[6]]
        middles = [scene.position[r[1]] + r[2] for r in spheres] or [np.zeros(3)]
        np.testing.assert_allclose(solver.origin[k], np.mean(middles, axis=0), atol=1e-12)
        slow = [
            [*(solver.origin[k] - scene.position[r[1]] - r[2]), 1.0] / np.maximum(r[4], 2.0)
            if r[6]
            else [*r[3], 0.0]
            for r in scene.of(robot)
        ]
        np.testing.assert_allclose(row[solver.of == k][:-1], slow, atol=1e-12)
        rank = (np.linalg.svd(np.array(slow))[1] > INDEPENDENT).sum()
        assert solver.rank()[k] == rank


@pytest.mark.parametrize("counts", SCENES)
@pytest.mark.parametrize("seed", range(3))
def test_one_crossing_of_exact_rows_is_where_the_robot_is(counts, seed):
    """The other is its mirror image in the plane of three spheres; the upper one is first."""
    scene = Scene(*counts, seed)

    points = scene.solver.crossings()

    for k, robot in enumerate((6, 7)):
        away = np.linalg.norm(points[k] - scene.truth[k], axis=1)
        assert away.min() < 1e-7
        assert points[k, 0, 2] >= points[k, 1, 2]
        middles = [scene.position[r[1]] + r[2] for r in scene.of(robot) if r[6]]
        if len(middles) == POINTS and len(scene.of(robot)) == POINTS:
            normal = np.cross(middles[1] - middles[0], middles[2] - middles[0])
            normal /= np.linalg.norm(normal)
            image = scene.truth[k] - 2.0 * normal * (normal @ (scene.truth[k] - middles[0]))
            assert np.linalg.norm(points[k] - image, axis=1).min() < 1e-7
            assert away.max() > 0.01


@pytest.mark.parametrize("counts", [(3, 0), (2, 2), (5, 3)])
def test_rows_weigh_by_their_variance_and_that_of_partners(counts):
    """Steps end at the minimum of the weighted squares that a general optimizer finds."""
    scene = Scene(*counts, off=0.1)

    found, misfit = scene.solver.descend(scene.truth[:, None])

    for k, robot in enumerate((6, 7)):
        rows = scene.of(robot)
        weight = np.sqrt([scene.precision(row) for row in rows])
        best = least_squares(
            lambda point, rows=rows, weight=weight: (
                weight * [scene.missed(row, point)[0] for row in rows]
            ),
            scene.truth[k], xtol=1e-14, ftol=1e-14, gtol=1e-14,
        )  # fmt: skip
        np.testing.assert_allclose(found[k, 0], best.x, atol=1e-4)
        assert misfit[k, 0] == pytest.approx(2.0 * best.cost, rel=1e-6)


def test_steps_are_no_longer_than_rows_reach():
    """Beyond the farthest row, in the least angle that counts as independent."""
    scene = Scene(2, 2)
    solver = scene.solver

    bound = solver.bound[:, 0, 0]
    far, near = solver._bounded(np.full((2, 1, 3), 1e9)), solver._bounded(np.full((2, 1, 3), 1.0))

    for k, robot in enumerate((6, 7)):
        reach = [
            np.linalg.norm(scene.position[r[1]] + r[2] - solver.origin[k]) + abs(r[4])
            for r in scene.of(robot)
        ]
        from_world = np.linalg.norm(solver.origin[k])  # the row of infinite variance
        assert bound[k] == pytest.approx((max([from_world, *reach]) + 2.0) / INDEPENDENT)
    np.testing.assert_allclose(np.linalg.norm(far, axis=2)[:, 0], bound)
    np.testing.assert_array_equal(near, 1.0)


@pytest.mark.parametrize("counts", SCENES)
def test_covariances_are_those_of_weighted_rows(counts):
    """Of partners off independently, and of partners off by the same vector."""
    scene = Scene(*counts)
    prior = np.array([0.5, 2.0])

    alone, together = scene.solver.covariance(scene.truth, prior, 3.0 * scene.covariance)

    for k, robot in enumerate((6, 7)):
        information, noise = prior[k] * np.eye(3), prior[k] * np.eye(3)
        of_partners, total, moved = np.zeros((3, 3)), 0.0, np.zeros((3, 3))
        for row in scene.of(robot):
            weight, way = scene.precision(row), scene.missed(row, scene.truth[k])[1]
            information += weight * np.outer(way, way)
            noise += weight**2 * row[5] * np.outer(way, way)
            if row[1] != WORLD:
                of_partners += weight * 3.0 * scene.covariance[row[1]]
                total += weight
                moved += weight * np.outer(way, way)
        inverse = np.linalg.inv(information)
        np.testing.assert_allclose(alone[k], inverse, rtol=1e-8, atol=1e-12)
        shared = inverse @ moved @ (of_partners / total) @ moved @ inverse
        np.testing.assert_allclose(
            together[k], inverse @ noise @ inverse + shared, rtol=1e-8, atol=1e-12
        )


@pytest.mark.parametrize("least", [1e-3, 8.0, 40.0, 1e6])
def test_axes_are_open_where_rows_say_less_than_asked_for(least):
    """The variance of partners does not count; a robot below the rank has one at least."""
    for counts in [(1, 0), (0, 1), (2, 0), (3, 0), (5, 3)]:
        scene = Scene(*counts, seed=1)

        found = scene.solver.open_axes(scene.truth, np.full(2, least))

        for k, robot in enumerate((6, 7)):
            information = np.zeros((3, 3))
            for row in scene.of(robot):
                way = scene.missed(row, scene.truth[k])[1]
                information += np.outer(way, way) / row[5]
            square, axis = np.linalg.eigh(information)
            is_open = square < max(least, 1e-9 * square[2])
            is_open[0] |= scene.solver.rank()[k] < POINTS
            slow = (axis**2)[:, is_open].sum(axis=1) > INDEPENDENT**2
            np.testing.assert_array_equal(found[k], slow)
