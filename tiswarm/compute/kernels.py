"""Kernels and functions that more than one room uses."""

from tiswarm.compute.dialect import Reals1, ti


@ti.func
def vector_at(rows: ti.template(), i):
    """Read row `i` of a table with three columns."""
    return ti.Vector([rows[i, 0], rows[i, 1], rows[i, 2]])


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
