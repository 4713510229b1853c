"""Cameras contain the scene, and rays hit the right capsule."""

from dataclasses import replace

import numpy as np
import pytest

from tiswarm.report.pictures.pictures import build_pictures
from tiswarm.report.pictures.raycast import taichi_tracer
from tiswarm.report.pictures.scene import fit_camera, mesh_capsules
from tiswarm.report.run_data import load_run
from tiswarm.report.swarm_view import read_case_view


@pytest.fixture
def scene(run_folder):
    """Truth and estimate of twelve robots."""
    return build_pictures(read_case_view(load_run(run_folder).cases[0]))["truth-and-estimate"].scene


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 30), (40, 1, 1), (1, 40, 1), (0, 0, 0)])
def test_every_ball_is_inside_the_picture(shape):
    """Structures of all shapes fill the picture and are not cut off."""
    points = np.random.default_rng(0).normal(size=(50, 3)) * shape

    camera = fit_camera(points, 1.0)

    right, up, depth = camera.project(points).T
    width, height = camera.half_height * camera.width / camera.height, camera.half_height
    slack = [
        (half * depth - np.abs(place)) / np.hypot(1.0, half)
        for place, half in ((right, width), (up, height))
    ]
    assert 1.0 <= np.min(slack) < 1.0 + 0.1 * max(width, height) * depth.max()


def test_robots_without_an_estimate_are_drawn_once(run_folder):
    """A robot without an estimate appears among the true robots only."""
    case = load_run(run_folder).cases[0]
    whole = build_pictures(read_case_view(case))["truth-and-estimate"].scene
    table = case.folder / "robots.csv"
    header, *robots = table.read_text().splitlines()
    cells = robots[-1].split(",")
    cells[8:11] = ["", "", ""]
    table.write_text("\n".join([header, *robots[:-1], ",".join(cells)]) + "\n")

    scene = build_pictures(read_case_view(case))["truth-and-estimate"].scene

    assert len(whole.radius) - len(scene.radius) == 4  # a rod, and a hub, an arm and a dock


def test_first_capsule_along_each_ray_is_found(scene):
    """Tiles and kernel agree with ray marching."""
    camera = scene.camera
    pixels = np.random.default_rng(0).uniform((0, 0), (camera.width, camera.height), (300, 2))
    pixels = pixels.astype(np.float32)

    depth, seen = taichi_tracer(scene)(pixels, camera.directions(pixels))

    marched = march(scene, camera.directions(pixels).astype(float))
    assert np.isfinite(marched).any()
    np.testing.assert_array_equal(np.isfinite(depth), np.isfinite(marched))
    hit = np.isfinite(depth)
    np.testing.assert_allclose(depth[hit], marched[hit], atol=2e-3)  # float32 at depth 100
    points = camera.eye + depth[hit, None] * camera.directions(pixels[hit])
    distance = distance_to_segments(points, scene.start[seen[hit]], scene.end[seen[hit]])
    np.testing.assert_allclose(distance, scene.radius[seen[hit]], atol=2e-3)


def march(scene, direction, steps=400):
    """Walk along rays by the distance to the nearest capsule; infinite where none is met."""
    depth = np.zeros(len(direction))
    gap = np.zeros(len(direction))
    for _ in range(steps):
        points = scene.camera.eye + depth[:, None] * direction
        gap = np.min(
            [
                distance_to_segments(points, start, end) - radius
                for start, end, radius in zip(scene.start, scene.end, scene.radius, strict=True)
            ],
            axis=0,
        )
        depth += gap / np.linalg.norm(direction, axis=1)
    return np.where(gap < 1e-4, depth, np.inf)


def distance_to_segments(points, start, end):
    """Distance from each point to a segment of its own, or to one for all."""
    span = end.astype(float) - start
    length = np.maximum((span**2).sum(axis=-1), 1e-12)
    along = np.clip(((points - start) * span).sum(axis=-1) / length, 0.0, 1.0)
    return np.linalg.norm(points - start - along[..., None] * span, axis=-1)


def test_meshes_lie_just_inside_their_capsules(scene):
    """Corners lie on the capsule, and triangles look outward."""
    mesh = mesh_capsules(replace(scene, ground=None))

    start, end = scene.start[mesh.point_capsule], scene.end[mesh.point_capsule]
    distance = distance_to_segments(mesh.point.astype(float), start, end)
    np.testing.assert_allclose(distance, scene.radius[mesh.point_capsule], atol=1e-4)
    a, b, c = (mesh.point[mesh.triangle[:, k]] for k in range(3))
    middle = scene.start[mesh.triangle_capsule] + scene.end[mesh.triangle_capsule]
    outward = (a + b + c) / 3.0 - middle / 2.0
    assert (np.sum(np.cross(b - a, c - a) * outward, axis=1) > 0.0).all()
