"""Offscreen pictures of structures, by whichever renderer the machine can run."""

from tiswarm.report.render.pictures import Rendered, render_run

__all__ = ["Rendered", "render_run"]
