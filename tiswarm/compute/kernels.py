"""Kernels and functions that more than one room uses."""

from tiswarm.compute.lang import Reals1, Ref, ti


@ti.func
def vector_at(rows: Ref, i):
    """Read row `i` of a table with three columns."""
    return ti.Vector([rows[i, 0], rows[i, 1], rows[i, 2]])


@ti.func
def vector_in(array: Ref, i, j):
    """Read a vector from the last axis of a three-dimensional array."""
    return ti.Vector([array[i, j, 0], array[i, j, 1], array[i, j, 2]])


@ti.func
def quaternion_at(array: Ref, i, j):
    """Read a quaternion likewise."""
    return ti.Vector([array[i, j, c] for c in range(4)])


@ti.kernel
def probe_arithmetic(value: Reals1):
    """Replace each value by sqrt(cos^2 + sin^2) of it times it: the same value, to rounding.

    Shows in which precision a device computes, and whether it knows these functions in it.

    Args:
        value: Read and written, shape (n,).
    """
    for i in range(value.shape[0]):
        c = ti.cos(value[i])
        s = ti.sin(value[i])
        value[i] *= ti.sqrt(c * c + s * s)
