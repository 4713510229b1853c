"""Distances to triangles, and how often these wind around points, as kernels.

Threads share the points of a grid by x, and each takes all triangles in their order: no two write
the same value.
"""

from tiswarm.compute.lang import F64, GRAIN, I32, Reals2, Reals3, ti
from tiswarm.compute.math_kernels import part_at


@ti.func
def triangle_distance(point, a, b, c):
    """Return the distance from a point to a triangle [R].

    The nearest place is a corner, on an edge, or inside: the signs of six products say which
    (Ericson, Real-Time Collision Detection, 5.1.5).
    """
    ab, ac, ap = b - a, c - a, point - a
    bp, cp = point - b, point - c
    d1, d2 = ab.dot(ap), ac.dot(ap)
    d3, d4 = ab.dot(bp), ac.dot(bp)
    d5, d6 = ab.dot(cp), ac.dot(cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    nearest = a
    if d1 <= 0.0 and d2 <= 0.0:
        nearest = a
    elif d3 >= 0.0 and d4 <= d3:
        nearest = b
    elif d6 >= 0.0 and d5 <= d6:
        nearest = c
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        nearest = a + d1 / (d1 - d3) * ab
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        nearest = a + d2 / (d2 - d6) * ac
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        nearest = b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)
    else:
        nearest = a + (vb * ab + vc * ac) / ti.max(va + vb + vc, 1e-300)
    return (point - nearest).norm()


@ti.kernel
def spread_distances(
    triangle: Reals2, low_x: F64, low_y: F64, low_z: F64, cell: F64, band: F64, value_out: Reals3
):
    """Lower the values of a grid to the distances to triangles, as far as these are less.

    Args:
        triangle: Three corners of each [R], shape (M, 9).
        low_x: Least x of the grid [R].
        low_y: Least y.
        low_z: Least z.
        cell: Distance between neighbors [R].
        band: Distance beyond which nothing changes [R].
        value_out: Distances [R], read, too, shape (nx, ny, nz).
    """
    for i, idle in ti.ndrange(value_out.shape[0], GRAIN):
        if idle == 0:
            x = low_x + cell * i
            for m in range(triangle.shape[0]):
                a, b, c = part_at(triangle, m, 0), part_at(triangle, m, 3), part_at(triangle, m, 6)
                low, high = ti.min(a, ti.min(b, c)) - band, ti.max(a, ti.max(b, c)) + band
                if low[0] <= x <= high[0]:
                    first_y = ti.max(ti.cast(ti.ceil((low[1] - low_y) / cell), I32), 0)
                    first_z = ti.max(ti.cast(ti.ceil((low[2] - low_z) / cell), I32), 0)
                    last_y = ti.min(
                        ti.cast(ti.floor((high[1] - low_y) / cell), I32), value_out.shape[1] - 1
                    )
                    last_z = ti.min(
                        ti.cast(ti.floor((high[2] - low_z) / cell), I32), value_out.shape[2] - 1
                    )
                    for j in range(first_y, last_y + 1):
                        for k in range(first_z, last_z + 1):
                            point = ti.Vector([x, low_y + cell * j, low_z + cell * k])
                            distance = triangle_distance(point, a, b, c)
                            value_out[i, j, k] = ti.min(value_out[i, j, k], distance)


@ti.kernel
def count_windings(
    triangle: Reals2, low_x: F64, low_y: F64, low_z: F64, cell: F64, winding_out: Reals3
):
    """Count how often a closed surface winds around each point of a grid: 0 outside.

    Above each point, faces that point up count 1 and those that point down -1.

    Args:
        triangle: Three corners of each [R], shape (M, 9).
        low_x: Least x of the grid [R].
        low_y: Least y.
        low_z: Least z.
        cell: Distance between neighbors [R].
        winding_out: Windings, 0 at first, shape (nx, ny, nz).
    """
    for i, idle in ti.ndrange(winding_out.shape[0], GRAIN):
        if idle == 0:
            x = low_x + cell * i
            for m in range(triangle.shape[0]):
                a, b, c = part_at(triangle, m, 0), part_at(triangle, m, 3), part_at(triangle, m, 6)
                low, high = ti.min(a, ti.min(b, c)), ti.max(a, ti.max(b, c))
                area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
                if low[0] <= x <= high[0] and area != 0.0:
                    first = ti.max(ti.cast(ti.ceil((low[1] - low_y) / cell), I32), 0)
                    last = ti.cast(ti.floor((high[1] - low_y) / cell), I32)
                    for j in range(first, ti.min(last, winding_out.shape[1] - 1) + 1):
                        y = low_y + cell * j
                        u = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
                        v = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
                        if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                            z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                            up = ti.select(area > 0.0, 1.0, -1.0)
                            end = ti.ceil((z - low_z) / cell)
                            count = ti.min(ti.cast(end, I32), winding_out.shape[2])
                            for k in range(count):
                                winding_out[i, j, k] += up
