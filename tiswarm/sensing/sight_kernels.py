"""Kernel of line of sight: which segments meet the docks of other robots."""

from typing import NamedTuple

from tiswarm.compute.lang import F64, I32, Ints1, Ints2, Reals2, Ref, kernel_struct, ti
from tiswarm.compute.math_kernels import vector_at
from tiswarm.compute.neighbor_kernels import CellList, cube_of, first_item, link


@kernel_struct
class SightLimits:
    """Numbers of one search."""

    radius: F64
    """Radius of a dock [R]."""

    edge: F64
    """Edge of a cell [R]."""

    stride: F64
    """Longest way between two places of a segment at which cells are looked up [R].

    Cells around a place hold all docks within an edge of it. A dock that the segment meets lies
    within a radius of a point of it, which is at most half a stride along from such a place."""

    docks: I32
    """Docks of a robot."""


class Segments(NamedTuple):
    """K segments."""

    start: Reals2
    """Where each begins [R], shape (K, 3)."""

    end: Reals2
    """Where each ends [R], shape (K, 3)."""

    near: Reals2
    """Part of each near any docks, from and to [1], shape (K, 2); to < from where there is none."""

    robots: Ints2
    """Rows of (first robot that does not block, two robots that do not block), shape (K, 3)."""


@ti.func
def _is_met_at(limits: Ref, place, a, way, s: Ref, segments: Ref, dock: Ref, cells: Ref):
    """Whether a segment from `a` along `way` meets a dock in the cells around one of its places."""
    is_met = False
    cube = cube_of(place, 1 / limits.edge)
    for which in range(27):
        item = first_item(cells, 0, cube, which)
        while item >= 0 and not is_met:
            robot = item // limits.docks
            is_own = robot == segments.robots[s, 1] or robot == segments.robots[s, 2]
            if robot < segments.robots[s, 0] and not is_own:
                offset = vector_at(dock, item) - a
                along = offset.dot(way)
                share = ti.select(along > 0, ti.min(along / way.norm_sqr(), 1), 0)
                is_met = (offset - share * way).norm_sqr() < limits.radius * limits.radius
            item = cells.following[0, item]
    return is_met


@ti.kernel
def find_blocked(
    limits: SightLimits, dock: Reals2,
    start: Reals2, end: Reals2, near: Reals2, robots: Ints2,  # Segments
    head_out: Ints2, following_out: Ints2,  # CellList, empty at first
    blocked_out: Ints1,
):  # fmt: skip
    """Find the segments that meet docks.

    Args:
        limits: Radius and cells.
        dock: Centers of docks, robot by robot [R], shape (M, 3).
        blocked_out: Whether each segment meets a dock, shape (K,).
    """
    segments = ti.static(Segments(start, end, near, robots))
    cells = ti.static(CellList(head_out, following_out))
    ti.loop_config(serialize=True)
    for m in range(dock.shape[0]):
        link(cells, 0, m, cube_of(vector_at(dock, m), 1 / limits.edge))
    for s in range(blocked_out.shape[0]):
        a = vector_at(start, s)
        way = vector_at(end, s) - a
        length = (near[s, 1] - near[s, 0]) * way.norm()
        is_met = False
        k = 0
        strides = ti.cast(ti.ceil(length / limits.stride), ti.i32)
        while k <= strides and not is_met and length >= 0:
            share = near[s, 0] + (near[s, 1] - near[s, 0]) * k / ti.max(strides, 1)
            is_met = _is_met_at(limits, a + share * way, a, way, s, segments, dock, cells)
            k += 1
        blocked_out[s] = is_met
