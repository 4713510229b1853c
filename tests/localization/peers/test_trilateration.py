"""Spheres and planes that a robot lies on, against their equations row by row."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from tiswarm.localization.peers.hop_by_hop import (
    INDEPENDENT,
    POINTS,
    Ties,
    Trilateration,
    unit,
)

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

    def equations(self, robot, origin):
        """Coefficients and right sides of a robot's rows, linear in x and |x|^2 / 2 R.

        Divided by the radius of a sphere, but no less than 2 R, what is left is a distance.
        """
        row, value = [], []
        for _, partner, shift, normal, reach, _, is_sphere in self.of(robot):
            middle = self.position[partner] + shift - origin
            radius = max(reach, 2.0)
            row.append([*(-middle / radius), 1.0 / radius] if is_sphere else [*normal, 0.0])
            square = 0.5 * (reach**2 - middle @ middle)
            value.append(square / radius if is_sphere else reach + normal @ middle)
        return np.array(row), np.array(value)


SCENES = [(3, 0), (4, 0), (0, 3), (2, 2), (5, 3)]


@pytest.mark.parametrize("counts", [(1, 0), (0, 1), (2, 0), (1, 1), *SCENES])
@pytest.mark.parametrize("seed", range(3))
def test_the_rank_counts_independent_equations(counts, seed):
    """By the singular values of unit rows, about the mean of the middles of spheres."""
    scene = Scene(*counts, seed)

    rank = scene.solver.rank()

    for k, robot in enumerate((6, 7)):
        origin = scene.solver.origin[k]
        middles = [scene.position[r[1]] + r[2] for r in scene.of(robot) if r[6]]
        np.testing.assert_allclose(origin, np.mean(middles or [np.zeros(3)], axis=0), atol=1e-12)
        assert rank[k] == (np.linalg.svd(scene.equations(robot, origin)[0])[1] > INDEPENDENT).sum()


@pytest.mark.parametrize("counts", [(3, 0), (4, 0), (2, 2), (5, 3)])
@pytest.mark.parametrize("off", [0.05, 0.5, 2.0])
@pytest.mark.parametrize("seed", range(4))
def test_crossings_are_where_the_line_that_rows_determine_best_meets_the_paraboloid(
    counts, seed, off
):
    """With rows that contradict each other; the upper point is first. A line can miss."""
    scene = Scene(*counts, seed, off=off)

    points = scene.solver.crossings()

    for k, robot in enumerate((6, 7)):
        origin = scene.solver.origin[k]
        row, value = scene.equations(robot, origin)
        root = np.sqrt([scene.precision(each) for each in scene.of(robot)])
        left, size, axis = np.linalg.svd(root[:, None] * row)
        foot = axis[:3].T @ ((left.T @ (root * value))[:3] / size[:3])
        along = axis[3]
        roots = np.roots([
            along[:3] @ along[:3],
            2.0 * foot[:3] @ along[:3] - 2.0 * along[3],
            foot[:3] @ foot[:3] - 2.0 * foot[3],
        ])  # fmt: skip
        if np.isreal(roots).all():
            slow = [origin + foot[:3] + step * along[:3] for step in roots.real]
            slow.sort(key=lambda point: -point[2])
            np.testing.assert_allclose(points[k], slow, atol=1e-6)
        else:
            np.testing.assert_array_equal(points[k, 0], points[k, 1])


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


def test_points_are_no_farther_than_rows_reach():
    """The farthest row, in the least angle that counts as independent."""
    scene = Scene(2, 2)

    bound = scene.solver.bound[:, 0, 0]

    for k, robot in enumerate((6, 7)):
        origin = scene.solver.origin[k]
        reach = [np.linalg.norm(origin)]  # of the row of infinite variance, from the world
        for row in scene.of(robot):
            away = scene.position[row[1]] + row[2] - origin
            reach.append(np.linalg.norm(away) + abs(row[4]))
        assert bound[k] == pytest.approx((max(reach) + 2.0) / INDEPENDENT)


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


def test_unit_vectors_are_of_length_one_however_short_they_were():
    """Only 0 has no direction, and stays."""
    vector = np.array([[3e-9, 0.0, 4e-9], [0.3, -0.4, 0.0], [30.0, 0.0, 40.0], [0.0, 0.0, 0.0]])

    found = unit(vector)

    expected = [[0.6, 0.0, 0.8], [0.6, -0.8, 0.0], [0.6, 0.0, 0.8], [0.0, 0.0, 0.0]]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
