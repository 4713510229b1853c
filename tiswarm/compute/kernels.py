"""Kernels and functions that more than one room uses."""

from tiswarm.compute.dialect import Reals1, ti


@ti.kernel
def probe_square_root(value: Reals1):
    """Replace each value by its square root, to see in which precision the device computes.

    Args:
        value: Read and written, shape (n,).
    """
    for i in range(value.shape[0]):
        value[i] = ti.sqrt(value[i])
