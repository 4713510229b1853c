"""Finds out which renderers work here, by letting each draw a tiny picture."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tiswarm.report.render.build import Robots, build_scene
from tiswarm.report.render.legend import TRUE_BLUE
from tiswarm.report.render.packages import installation_advice
from tiswarm.report.render.pictures import RENDERERS, RendererError, draw_in_child
from tiswarm.report.render.scene import Scene
from tiswarm.report.render.subjects import TRUE_SIZE
from tiswarm.robot import RobotGeometry


class RendererStatus(NamedTuple):
    """Whether a renderer works on this machine."""

    name: str
    works: bool
    detail: str
    """How long the test picture took, or what went wrong and what to install."""


def probe_renderers() -> list[RendererStatus]:
    """Let every renderer draw one robot in a process of its own, side by side."""
    scene = _tiny_scene()
    with ThreadPoolExecutor(len(RENDERERS)) as pool:
        return list(pool.map(lambda name: _probe(name, scene), RENDERERS))


def _probe(name: str, scene: Scene) -> RendererStatus:
    begin = time.perf_counter()
    try:
        draw_in_child([scene], name)
    except RendererError as error:
        advice = [] if name == "taichi" else installation_advice()
        return RendererStatus(name, works=False, detail="; ".join([str(error), *advice]))
    took = time.perf_counter() - begin
    return RendererStatus(name, works=True, detail=f"drew a test picture in {took:.1f} s")


def _tiny_scene() -> Scene:
    center = np.array([[0.0, 0.0, 1.0]])
    dock = center + RobotGeometry().dock_offset_body[None]
    robots = Robots(center=center, dock=dock, color=np.array([TRUE_BLUE]), look=TRUE_SIZE)
    scene = build_scene([robots], 0.0)
    camera = scene.camera
    small = replace(camera, width=camera.width // 10, height=camera.height // 10)
    return replace(scene, camera=small)
