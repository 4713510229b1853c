"""Blocks of 6 x 6 numbers, and the steps of elimination that kernels share.

A block is six rows of eight numbers, and the last two of each are 0: compilers keep such a row in
one register, whose numbers are added and multiplied at once (`numerics.native_vectors`). A kernel
holds a block as a list of its rows.
"""

from typing import TYPE_CHECKING, Any

from tiswarm.compute.lang import Ref, ti

ROW_WIDTH = 8
"""Numbers in a row of a block."""

if TYPE_CHECKING:
    Rows = Any
    Blocks = Any
else:
    # What a compiler loads at once has to be one vector.
    Rows = ti.types.ndarray(dtype=ti.types.vector(ROW_WIDTH, ti.f64), ndim=2)
    Blocks = ti.types.ndarray(dtype=ti.types.vector(ROW_WIDTH, ti.f64), ndim=3)


@ti.func
def stiffness_row(stiffness: Ref, s, part, i):
    """Read row i of a part of the beams' stiffness, shape (S, 4 B, 6, 6), as eight numbers."""
    return ti.Vector([
        stiffness[s, part, i, 0], stiffness[s, part, i, 1], stiffness[s, part, i, 2],
        stiffness[s, part, i, 3], stiffness[s, part, i, 4], stiffness[s, part, i, 5], 0.0, 0.0,
    ])  # fmt: skip


@ti.func
def subtract_product(block: Ref, rows: Ref, s, first_a, first_b, count):
    """Subtract Z_a' Z_b from a block, always in the same order.

    Z_a and Z_b have `count` rows each, from the rows `first_a` and `first_b` of structure s on. A
    loop over them starts sooner than lines for each row, and takes no longer.
    """
    for row in range(count):
        z_a = rows[s, first_a + row]
        z_b = rows[s, first_b + row]
        for i in ti.static(range(6)):
            block[i] = block[i] - z_a[i] * z_b


@ti.func
def factorize(c: Ref):
    """Replace K by C' of C C' = K; what is below the diagonal is neither read nor 0 after that."""
    # Row i of C': (K_i - sum of C_it times row t) / C_ii
    for i in ti.static(range(6)):
        for t in ti.static(range(i)):
            c[i] = c[i] - c[t][i] * c[t]
        # NaN also where rounding makes a pivot 0.
        root = ti.select(c[i][i] > 0.0, ti.sqrt(c[i][i]), ti.math.nan)
        c[i] = c[i] / root
        c[i][i] = root


@ti.func
def solve_lower(c: Ref, y: Ref):
    """Replace f by y = C^-1 f, from the first number to the last."""
    for i in ti.static(range(6)):
        y_i = y[i]
        for t in ti.static(range(i)):
            y_i -= c[t][i] * y[t]
        y[i] = y_i / c[i][i]


@ti.func
def solve_rows(c: Ref, z: Ref):
    """Replace K by Z = C^-1 K, from the first row to the last."""
    for i in ti.static(range(6)):
        for t in ti.static(range(i)):
            z[i] = z[i] - c[t][i] * z[t]
        z[i] = z[i] / c[i][i]


@ti.func
def solve_upper(c: Ref, u: Ref):
    """Replace y by u = C'^-1 y, from the last number to the first."""
    for back in ti.static(range(6)):
        i = ti.static(5 - back)
        u_i = u[i]
        for j in ti.static(range(i + 1, 6)):
            u_i -= c[i][j] * u[j]
        u[i] = u_i / c[i][i]
